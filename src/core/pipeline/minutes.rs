//! A time limit: chooses the image size and the numbers of Gaussians and steps of a run, where its
//! options leave them open.
//!
//! All three are chosen before the run, by the times of its parts in this machine's last runs. The
//! steps are chosen again once the poses and the shake are known, and adjusted once in each round
//! by the pace of that round ([`Pacing`]).

use serde::{Deserialize, Serialize};

use super::config::{Options, OptionsError, Setting, USUAL_ROUNDS};
use super::context::Context;
use super::effective::Effective;
use super::error::PipelineError;
use super::plan::{Expected, Forecast, Rounds};
use super::views::View;
use super::workspace::{Workspace, fingerprint};
use crate::capture::Capture;
use crate::device::Device;
use crate::reconstruct::Look;

/// Size, Gaussians and steps that suit each other.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rung {
    /// Longest side of the working images, px.
    side: f64,
    cap: f64,
    /// Steps of each of [`USUAL_ROUNDS`]; more rounds have fewer each.
    steps: f64,
}

/// The least worth running, and the numbers of the details `standard` and `high`. Between them all
/// three grow together.
const RUNGS: [Rung; 3] = [
    Rung { side: 280.0, cap: 10_000.0, steps: 300.0 },
    Rung { side: 560.0, cap: 30_000.0, steps: 1_000.0 },
    Rung { side: 1_600.0, cap: 1_000_000.0, steps: 3_500.0 },
];
/// Choices between one rung and the next.
const BETWEEN: u32 = 64;
/// Steps that a run has in all, at least and at most, however many rounds there are.
const ALL_STEPS: (u32, u32) = (600, 7_000);

/// Longest side of working images that the option allows, px.
const LEAST_SIDE: u32 = 64;

/// The numbers chosen under a time limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Numbers {
    size: u32,
    cap: u32,
    steps: u32,
}

impl Numbers {
    /// The options with these numbers where they leave them open.
    fn options(self, options: &Options) -> Options {
        let fitted = |setting: Setting, number| {
            if setting.is_open() { Setting::Fitted(number) } else { setting }
        };
        Options {
            size: fitted(options.size, self.size),
            cap: fitted(options.cap, self.cap),
            steps: fitted(options.steps, self.steps),
            ..options.clone()
        }
    }
}

impl Rung {
    /// The rung at a height, in [`BETWEEN`]ths of the way from one of [`RUNGS`] to the next.
    fn at(height: u32) -> Self {
        let below = (height / BETWEEN).min(RUNGS.len() as u32 - 2);
        let share = f64::from(height - below * BETWEEN) / f64::from(BETWEEN);
        let [low, high] = [RUNGS[below as usize], RUNGS[below as usize + 1]];
        let between = |low: f64, high: f64| low * (high / low).powf(share);
        Self {
            side: between(low.side, high.side),
            cap: between(low.cap, high.cap),
            steps: between(low.steps, high.steps),
        }
    }

    /// Every rung, the highest first.
    fn all() -> impl Iterator<Item = Self> {
        (0..=BETWEEN * (RUNGS.len() as u32 - 1)).rev().map(Self::at)
    }

    /// The options with this rung's numbers where they leave them open. `longest` is the longest
    /// side of all photographs, px: images are never larger, and have as many Gaussians a pixel.
    fn options(self, options: &Options, longest: u32) -> Options {
        let longest =
            if options.size.is_open() { longest } else { longest.min(options.longest_side()) };
        let rounds = f64::from(options.round_count());
        let rung_of_images = Self::all().find(|rung| rung.side <= f64::from(longest));
        let cap = self.cap.min(rung_of_images.map_or(RUNGS[0].cap, |rung| rung.cap));
        let rounded = |number: f64, unit: f64| (unit * (number / unit).round()) as u32;
        let numbers = Numbers {
            size: rounded(self.side, 20.0).min(longest.max(LEAST_SIDE)),
            cap: rounded(cap, 1_000.0),
            steps: rounded(self.steps * f64::from(USUAL_ROUNDS) / rounds, 10.0).max(10),
        };
        numbers.options(options)
    }
}

/// Refuses a time limit where the options leave nothing to choose.
///
/// # Errors
/// [`OptionsError`].
pub fn check_minutes(options: &Options) -> Result<(), OptionsError> {
    let is_open = [options.size, options.cap, options.steps].into_iter().any(Setting::is_open);
    if minutes(options).is_none() || is_open {
        return Ok(());
    }
    let message = "`size`, `cap` and `steps` are all set, by you or by the preset, and decide how \
                   long the run takes; set one of them to `auto`, best all three";
    Err(OptionsError { key: "minutes".to_owned(), message: message.to_owned() })
}

fn minutes(options: &Options) -> Option<u32> {
    match options.minutes {
        Setting::Given(minutes) => Some(minutes),
        Setting::Auto | Setting::Fitted(_) => None,
    }
}

/// The decisions under a time limit, made once and kept: a resumed run continues in the same way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeLimit {
    depends_on: String,
    minutes: u32,
    numbers: Numbers,
    /// The time that the whole run is expected to take.
    seconds: f64,
    /// Whether this machine has done all of its parts before.
    is_known: bool,
    /// Whether the options leave the steps open.
    fills: bool,
    /// The steps of a round for the time that was left before the rounds.
    refilled: Option<Refilled>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Refilled {
    steps: u32,
    /// The time that had passed before the rounds, and that of the whole run, s.
    spent: f64,
    seconds: f64,
}

impl TimeLimit {
    /// The decision of an earlier process about this run, or a new one; `None` if the options set
    /// no limit.
    ///
    /// # Errors
    /// Those of [`check_minutes`]; [`PipelineError::Io`].
    pub fn choose(
        options: &Options,
        capture: &Capture,
        device: &Device,
        forecast: &Forecast,
        workspace: &Workspace,
    ) -> Result<Option<Self>, PipelineError> {
        check_minutes(options)?;
        let Some(minutes) = minutes(options) else {
            return Ok(None);
        };
        let asked = serde_json::to_string(options).expect("plain data has a JSON form");
        let depends_on = fingerprint(&[&asked, &capture.fingerprint, &device.identity()]);
        let kept: Option<Self> = workspace.read_json(&workspace.folder().work().minutes());
        if let Some(kept) = kept.filter(|kept| kept.depends_on == depends_on) {
            return Ok(Some(kept));
        }
        let longest = forecast.sizes().iter().flatten().max().copied().unwrap_or(0) as u32;
        let (fitted, expected) =
            climb(60.0 * f64::from(minutes), options, longest, |options| forecast.run(options));
        let limit = Self {
            depends_on,
            minutes,
            numbers: Numbers {
                size: fitted.longest_side(),
                cap: fitted.most_gaussians(),
                steps: fitted.steps_per_round(),
            },
            seconds: expected.seconds,
            is_known: expected.is_known,
            fills: options.steps.is_open(),
            refilled: None,
        };
        limit.keep(workspace)?;
        Ok(Some(limit))
    }

    fn keep(&self, workspace: &Workspace) -> Result<(), PipelineError> {
        workspace.write_json(&workspace.folder().work().minutes(), self)
    }

    /// The options with the numbers of the decision where they leave them open.
    pub fn options(&self, options: &Options) -> Options {
        self.numbers.options(options)
    }

    fn limit(&self) -> f64 {
        60.0 * f64::from(self.minutes)
    }

    fn in_words(&self) -> String {
        match self.minutes {
            1 => "limit of 1 minute".to_owned(),
            minutes => format!("limit of {minutes} minutes"),
        }
    }

    /// Reports the decision to the user, unless an earlier process has gone on from it.
    pub fn report(&self, context: &mut Context<'_>) {
        if self.refilled.is_some() {
            return;
        }
        let Numbers { size, cap, steps } = self.numbers;
        let limit = self.in_words();
        let takes = in_minutes(self.seconds);
        let message = format!(
            "{limit}: images of {size} px, at most {cap} Gaussians, {steps} steps a round; with \
             them the run takes about {takes}"
        );
        context.sink.log(message);
        if !self.is_known {
            let message = format!(
                "this machine has not finished a run like this one yet, so how long it takes is a \
                 guess and the {limit} may be missed; later runs know better"
            );
            context.sink.warn("minutes", message);
        } else if self.seconds > self.limit() {
            let message = format!(
                "even with the least detail that these options allow, the run takes about {takes} \
                 on this machine, longer than the {limit}"
            );
            context.sink.warn("minutes", message);
        }
    }

    /// Chooses the steps of the options in effect again, for the time left before the rounds,
    /// unless they were set or an earlier process chose them. Returns the time that the whole run
    /// is expected to take, s.
    ///
    /// # Errors
    /// [`PipelineError::Io`].
    pub fn refill(
        &mut self,
        context: &mut Context<'_>,
        options: &mut Options,
        rounds: Rounds,
        forecast: &Forecast,
    ) -> Result<f64, PipelineError> {
        let with = |steps| Options { steps: Setting::Fitted(steps), ..options.clone() };
        let refilled = match self.refilled {
            Some(refilled) => refilled,
            None => {
                let before: f64 = context.clock.stages().values().sum();
                let spent = context.clock.elapsed().max(before);
                let time = |options: &Options| forecast.rounds(options, rounds).seconds;
                let set = options.steps_per_round();
                let (steps, seconds) = if self.fills {
                    let (least, most) = (ALL_STEPS.0 / rounds.rounds, ALL_STEPS.1 / rounds.rounds);
                    fill(self.limit() - spent, least, most, |steps| time(&with(steps)))
                } else {
                    (set, time(options))
                };
                let refilled = Refilled { steps, spent, seconds: spent + seconds };
                self.refilled = Some(refilled);
                self.keep(context.workspace)?;
                refilled
            }
        };
        let Refilled { steps, spent, seconds } = refilled;
        let (limit, spent, takes) = (self.in_words(), in_minutes(spent), in_minutes(seconds));
        let message = format!(
            "{limit}: {spent} before the rounds, {steps} steps a round; the run takes about \
             {takes} in all"
        );
        if seconds > self.limit() {
            context.sink.warn("minutes", format!("{message}, longer than the limit"));
        } else {
            context.sink.log(message);
        }
        if self.fills {
            options.steps = Setting::Fitted(steps);
        }
        Ok(seconds)
    }
}

/// The limit of a run whose rounds are known.
#[derive(Clone, Copy)]
pub struct RoundsLimit<'a> {
    forecast: &'a Forecast,
    /// The options in effect.
    options: &'a Options,
    rounds: Rounds,
    /// Seconds of the whole run.
    limit: f64,
    /// Whether the options leave the steps open.
    fills: bool,
}

impl TimeLimit {
    /// The limit of these rounds.
    pub fn of_rounds<'a>(
        &self,
        forecast: &'a Forecast,
        options: &'a Options,
        rounds: Rounds,
    ) -> RoundsLimit<'a> {
        RoundsLimit { forecast, options, rounds, limit: self.limit(), fills: self.fills }
    }
}

impl<'a> RoundsLimit<'a> {
    /// The limit as it is for the round of this index: late views add views, and a round to a still
    /// capture.
    pub fn now(self, index: usize, effective: &Effective, views: &[View]) -> Self {
        let number = index as u32 + 1;
        let count = effective.rounds();
        let count = if number > count { effective.options.round_count() } else { count };
        let rounds = Rounds { rounds: count, views: views.len() as u32, ..self.rounds };
        Self { rounds, ..self }
    }

    /// The limit in the training of a round with this number and that many steps.
    pub fn pacing(self, round: u32, steps: u32) -> Pacing<'a> {
        Pacing { limit: self, round, planned: steps, began: None, is_over: !self.fills }
    }
}

/// Compares the pace of a round in training with that expected, once, and changes its steps so that
/// the run ends in time: captures differ, and so does what else the machine does.
pub struct Pacing<'a> {
    limit: RoundsLimit<'a>,
    round: u32,
    /// Steps of the round at its start.
    planned: u32,
    /// Step and seconds of the round from which its pace is measured.
    began: Option<(u32, f64)>,
    is_over: bool,
}

/// The share of a round from which its steps have the cost of most others, the share after which
/// their pace is judged, and the share that must then be left.
const MEASURED: (f64, f64) = (0.3, 0.4);
const LAST_CHANGE: f64 = 0.7;
/// Shares of a round that the steps so far may become: not so little that images of the full size
/// would be followed by smaller ones, and not so much that no Gaussian could be added any more.
const BECOMES: (f64, f64) = (0.31, 0.75);
/// The least that steps may take of their expected time: what is measured is not exact.
const LEAST_DRIFT: f64 = 0.05;
/// The least change of the steps that is made.
const LEAST_CHANGE: f64 = 0.03;

impl Pacing<'_> {
    /// Looks at a moment of the round, and changes its steps if it is time to.
    pub fn look(&mut self, look: &mut Look<'_>, context: &mut Context<'_>) {
        let Some((from, seconds)) = self.measured(look.step, look.steps, look.seconds) else {
            return;
        };
        let before: f64 = context.clock.stages().values().sum::<f64>() + look.seconds;
        let spent = context.clock.elapsed().max(before);
        let steps = self.steps([from, look.step], seconds, spent);
        let change = f64::from(steps) / f64::from(look.steps);
        if (change - 1.0).abs() < LEAST_CHANGE {
            return;
        }
        look.change_steps(steps);
        let why = if change < 1.0 { "to end in time" } else { "as time allows" };
        let message =
            format!("round {}: {steps} steps instead of {}, {why}", self.round, self.planned);
        context.sink.log(message);
    }

    /// The step from which the pace was measured and the seconds since then, once, when they tell
    /// enough of the round; `step` of its `steps` have taken `seconds`.
    fn measured(&mut self, step: u32, steps: u32, seconds: f64) -> Option<(u32, f64)> {
        if self.is_over || steps != self.planned {
            return None;
        }
        let share = |step: u32| f64::from(step) / f64::from(steps);
        let Some((from, begun)) = self.began else {
            self.began = (share(step) >= MEASURED.0).then_some((step, seconds));
            return None;
        };
        if share(step) < MEASURED.1 || share(step - from) < MEASURED.1 - MEASURED.0 {
            return None;
        }
        self.is_over = true;
        (share(step) <= LAST_CHANGE).then_some((from, seconds - begun))
    }

    /// The steps that this round, and each later one, may have if those between two took that many
    /// `seconds`, `spent` seconds after the start of the run.
    fn steps(&self, [from, to]: [u32; 2], seconds: f64, spent: f64) -> u32 {
        let RoundsLimit { forecast, options, rounds, limit, .. } = self.limit;
        let with = |steps| Options { steps: Setting::Fitted(steps), ..options.clone() };
        let of = |steps| forecast.rest(&with(steps), rounds, self.round);
        // Content changes the cost of steps; kernels and cameras cost about as much as ever.
        let ([done, other_done], [begun, other_begun]) =
            (of(self.planned).training(to), of(self.planned).training(from));
        let drift = (seconds - (other_done - other_begun)) / (done - begun).max(f64::EPSILON);
        let rest = |steps| {
            let expected = of(steps);
            let ([all, all_other], [done, other_done]) =
                (expected.training(steps), expected.training(to));
            let [later, other] = expected.after();
            drift.max(LEAST_DRIFT) * (all - done + later) + all_other - other_done + other
        };
        let (least, most) = BECOMES;
        let [most, least] = [least, most].map(|share| f64::from(to) / share);
        let all = ALL_STEPS.1 / rounds.rounds;
        fill(limit - spent, least.ceil() as u32, (most as u32).min(all).max(self.planned), rest).0
    }
}

/// The highest rung whose run takes at most `limit` seconds, or else the lowest.
fn climb(
    limit: f64,
    options: &Options,
    longest: u32,
    time: impl Fn(&Options) -> Expected,
) -> (Options, Expected) {
    let timed = |rung: Rung| {
        let options = rung.options(options, longest);
        let expected = time(&options);
        (options, expected)
    };
    let fitting = Rung::all().map(timed).find(|(_, expected)| expected.seconds <= limit);
    fitting.unwrap_or_else(|| timed(RUNGS[0]))
}

/// The greatest number of steps that takes at most `left` seconds, in tens, and its time.
fn fill(left: f64, least: u32, most: u32, time: impl Fn(u32) -> f64) -> (u32, f64) {
    let (mut low, mut high) = (least.div_ceil(10), most / 10);
    while low < high {
        let middle = (low + high).div_ceil(2);
        if time(10 * middle) <= left {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    (10 * low, time(10 * low))
}

fn in_minutes(seconds: f64) -> String {
    format!("{:.1} minutes", seconds / 60.0)
}

#[cfg(test)]
mod tests;
