//! Progress of a run: a bar for users, JSON lines for programs, and `log.txt` for both.

use std::fs::File;
use std::io::Write;
use std::time::{Duration, Instant};

use fled_core::event::{Event, ProgressSink, Stage};
use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

/// Writes every event to `log.txt`, and to the terminal or as JSON lines to standard output.
pub struct Reporter {
    log: File,
    started: Instant,
    bar: Option<ProgressBar>,
    json: bool,
}

impl Reporter {
    /// Appends to `log`, so that a resumed run's log holds its whole history.
    pub fn new(log: File, json: bool) -> Self {
        let bar = (!json).then(overall_bar);
        Self { log, started: Instant::now(), bar, json }
    }

    fn line(&mut self, text: &str) {
        let seconds = self.started.elapsed().as_secs_f64();
        // A full disk must not end a run that could still deliver: the log matters least.
        let _ = writeln!(self.log, "{seconds:9.1} {text}");
        if let Some(bar) = &self.bar {
            if bar.is_hidden() {
                eprintln!("{seconds:9.1} {text}");
            } else {
                bar.println(text);
            }
        }
    }

    fn show(&mut self, event: &Event) {
        if let Some(bar) = &self.bar {
            advance(bar, event);
        }
        for line in lines(event) {
            self.line(&line);
        }
        if let (Event::Finished { .. }, Some(bar)) = (event, &self.bar) {
            bar.finish_and_clear();
        }
    }
}

/// The bar of a whole run, in thousandths.
pub fn overall_bar() -> ProgressBar {
    let bar = ProgressBar::new(1000);
    let style = ProgressStyle::with_template("{bar:30} {percent:>3}% {prefix}{msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

/// Shows the finished share, and the time left if known.
pub fn show_progress(bar: &ProgressBar, share: f64, seconds_left: Option<f64>) {
    bar.set_position((share * 1000.0) as u64);
    let left = seconds_left.and_then(|left| Duration::try_from_secs_f64(left).ok());
    let left = left.map(|left| format!("{} left, ", HumanDuration(left)));
    bar.set_prefix(left.unwrap_or_default());
}

/// Updates the bar.
fn advance(bar: &ProgressBar, event: &Event) {
    match event {
        Event::StageStarted { stage, round } => bar.set_message(name(stage.name(), *round)),
        Event::StrategyStarted { name: strategy, .. } => {
            bar.set_message(format!("{}: {strategy}", name(Stage::Poses.name(), 0)));
        }
        Event::StageAdvanced { stage, round, done, total, steps_per_second } => {
            let rate =
                steps_per_second.map_or(String::new(), |rate| format!(", {rate:.1} steps/s"));
            bar.set_message(format!("{} {done}/{total}{rate}", name(stage.name(), *round)));
        }
        Event::Progress { progress, eta_seconds } => show_progress(bar, *progress, *eta_seconds),
        _ => {}
    }
}

/// The lines that an event adds to the log.
fn lines(event: &Event) -> Vec<String> {
    let line = match event {
        Event::StageStarted { .. }
        | Event::StageAdvanced { .. }
        | Event::TrainingSeen { .. }
        | Event::HeldOutSeen { .. }
        | Event::ViewSeen { .. }
        | Event::Progress { .. } => return Vec::new(),
        Event::RoundFinished { metrics } => return round_lines(metrics),
        Event::Planned { rounds, views, .. } => format!("{views} views, {rounds} rounds"),
        Event::DetailChosen { detail } => {
            format!("detail: {}, because {}", detail.level.name(), detail.because)
        }
        Event::StageFinished { stage, round, seconds, skipped } => {
            let how = if *skipped { "already done, took" } else { "done in" };
            format!("{} {how} {seconds:.1} s", name(stage.name(), *round))
        }
        Event::StrategyStarted { strategy, name } => format!("poses: strategy {strategy}, {name}"),
        Event::OverlapFound(overlap) => {
            format!("poses: matches connect the photographs in {}", overlap.in_words())
        }
        Event::Warning { code, message } => format!("warning ({code}): {message}"),
        Event::Log { message } => message.clone(),
        Event::Finished { best_round, seconds } => {
            format!("finished in {seconds:.1} s; round {best_round} is delivered")
        }
        Event::Failed { kind, detail, hint } => format!("failed ({kind}): {detail} {hint}"),
    };
    vec![line]
}

impl ProgressSink for Reporter {
    fn event(&mut self, event: &Event) {
        self.show(event);
        if self.json {
            print(event);
        }
    }
}

/// Writes an event as a JSON line to standard output.
pub fn print(event: &Event) {
    if let Ok(line) = serde_json::to_string(event) {
        let mut out = std::io::stdout().lock();
        // The reader may have closed the pipe: that must not end the run.
        let _ = writeln!(out, "{line}").and_then(|()| out.flush());
    }
}

/// The name of a stage in messages.
pub fn name(stage: &str, round: u32) -> String {
    if round == 0 { stage.to_owned() } else { format!("round {round} {stage}") }
}

/// A round's scores as lines of text.
pub fn round_lines(metrics: &fled_core::metrics::RoundMetrics) -> Vec<String> {
    let mut lines = vec![format!(
        "round {}: {} Gaussians, {} steps at {:.1}/s, {:.1} s",
        metrics.round, metrics.gaussians, metrics.steps, metrics.steps_per_second, metrics.seconds
    )];
    for r in &metrics.records {
        lines.push(format!(
            "  {:8} {:9} against {:9} {:6} {:2} views  PSNR {:5.2} dB  (colour-fitted {:5.2})  SSIM {:.4}",
            word(&r.split),
            word(&r.image),
            word(&r.reference),
            word(&r.brightness),
            r.views,
            r.psnr_db,
            r.psnr_cc_db,
            r.ssim
        ));
    }
    lines
}

/// The JSON name of an enum's value.
fn word(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default().trim_matches('"').to_owned()
}
