//! Validation of a job's options.

use std::path::PathBuf;

use fled_core::deblur::{BUILT_IN, Model, NetworkChoice, network_names};
use fled_core::device::PROCESSOR;
use fled_core::enhance::Target;
use fled_core::pipeline::check_minutes;
use fled_core::pipeline::config::{Detail, NetworkOption, Options, OptionsError, Preset};
use fled_core::reading::below;
use serde_json::{Map, Value};
use uuid::Uuid;

use super::priority::Priority;
use super::problem::Problem;
use crate::app::App;
use crate::store::{Engine, JobRow, Needs, NewJob};
use crate::validation::CaptureReport;

/// Memory of a machine that may run a job of the presets for GPUs, in bytes.
const LARGE_JOB_MEMORY: u64 = 12 << 30;

/// Maximum characters of a fragment of an adapter's name.
const LONGEST_ADAPTER: usize = 200;

/// The validated options of a job that has no capture yet.
pub(super) struct Order {
    preset: Preset,
    options: Options,
    priority: Priority,
}

impl Order {
    /// # Errors
    /// 422 with a pointer to the invalid option.
    pub(super) async fn new(
        app: &App,
        preset: Option<&str>,
        options: &Map<String, Value>,
        priority: Priority,
    ) -> Result<Self, Problem> {
        let preset: Preset = preset
            .unwrap_or(Preset::Auto.name())
            .parse()
            .map_err(|error: OptionsError| bad_option(&error).pointer("/preset"))?;
        let options =
            preset.options().with_overrides(options).map_err(|error| bad_option(&error))?;
        Self::checked(app, preset, options, priority).await
    }

    /// Validates new options for an existing job, on top of those it has.
    ///
    /// # Errors
    /// As [`Order::new`].
    pub(super) async fn again(
        app: &App,
        row: &JobRow,
        options: &Map<String, Value>,
    ) -> Result<Self, Problem> {
        let preset: Preset = row.preset.parse().map_err(|error: OptionsError| {
            tracing::error!(%error, job = row.id, "the job's preset is damaged");
            Problem::internal()
        })?;
        // The request may replace a value that only an older build accepted.
        let mut all = Options::known(&row.options);
        all.extend(options.clone());
        let options =
            Options::default().with_overrides(&all).map_err(|error| bad_option(&error))?;
        Self::checked(app, preset, options, Priority::of(row.priority)).await
    }

    async fn checked(
        app: &App,
        preset: Preset,
        options: Options,
        priority: Priority,
    ) -> Result<Self, Problem> {
        check_early(&options)?;
        // It reads the networks folder.
        let (folders, checked) = (app.config.models.clone(), options.clone());
        let check = move || {
            let networks = checked.networks().into_iter();
            networks
                .filter(|option| option.choice.is_network())
                .try_for_each(|option| check_network(&folders, option))
        };
        tokio::task::spawn_blocking(check).await.map_err(|_| Problem::internal())??;
        Ok(Self { preset, options, priority })
    }

    /// Returns whether the stored options, possibly of an older build, are the same.
    pub(super) fn asks_for(&self, options: &Value) -> bool {
        let stored = Options::default().with_overrides(&Options::known(options));
        stored.is_ok_and(|stored| stored == self.options)
    }

    /// Checks the options that name views against those of the capture.
    ///
    /// # Errors
    /// 422 for held-out views that the capture lacks.
    pub(super) fn check_views(&self, report: &CaptureReport) -> Result<(), Problem> {
        let held_out = self.options.held_out.as_str();
        let refused = |message: String| {
            let key = "held_out".to_owned();
            Err(bad_option(&OptionsError { key, message }))
        };
        match held_out.parse::<u64>() {
            _ if ["auto", "none"].contains(&held_out) => return Ok(()),
            Ok(2..) => return Ok(()),
            Ok(n) => {
                return refused(format!(
                    "holding out every {n}-th view leaves nothing to train on"
                ));
            }
            Err(_) => {}
        }
        let is_view =
            |name: &&str| report.images.iter().any(|image| image.view.as_deref() == Some(name));
        let mut requested = held_out.split(',').map(str::trim).filter(|w| !w.is_empty());
        match requested.find(|requested| !is_view(requested)) {
            None => Ok(()),
            Some(unknown) => refused(format!("`{unknown}` is not a view of this capture")),
        }
    }

    /// Creates the job for a capture.
    ///
    /// # Errors
    /// 500 if the options cannot be serialised.
    pub(super) fn job(&self, app: &App, capture: &str, name: &str) -> Result<NewJob, Problem> {
        Ok(NewJob {
            id: Uuid::now_v7().to_string(),
            name: name.chars().take(200).collect(),
            capture_id: capture.to_owned(),
            preset: self.preset.name().to_owned(),
            rounds: self.options.round_count(),
            needs: self.needs(app.store.engine()),
            priority: self.priority.number(),
            options: serde_json::to_value(&self.options).map_err(|_| Problem::internal())?,
        })
    }
}

impl Order {
    /// Requirements for the machine, if there are several: without a GPU, training with the paper's
    /// settings takes days, and the detail `high` is refused. Options that name the processor need
    /// no GPU, but as much memory.
    fn needs(&self, engine: Engine) -> Needs {
        let is_large = self.options.detail == Detail::High || self.preset == Preset::Paper;
        let gpu = self.options.adapter != PROCESSOR;
        match engine {
            Engine::Postgres if is_large => Needs { gpu, memory: LARGE_JOB_MEMORY },
            _ => Needs::default(),
        }
    }
}

/// Checks options that the job would otherwise refuse only after the photographs or poses.
fn check_early(options: &Options) -> Result<(), Problem> {
    check_minutes(options).map_err(|error| bad_option(&error))?;
    let target: Result<Target, _> = options.target.parse();
    target.map_err(|error| {
        bad_option(&OptionsError { key: "target".to_owned(), message: error.to_string() })
    })?;
    if options.adapter.chars().count() > LONGEST_ADAPTER {
        return Err(bad_option(&OptionsError {
            key: "adapter".to_owned(),
            message: format!("longer than {LONGEST_ADAPTER} characters"),
        }));
    }
    Ok(())
}

/// Checks that a network is chosen by name: a path would let a client probe the server's files.
fn check_network(folders: &[PathBuf], option: NetworkOption<'_>) -> Result<(), Problem> {
    let refused =
        |message: String| bad_option(&OptionsError { key: option.key.to_owned(), message });
    let (choice, names) = (option.choice.as_str(), network_names(folders));
    let built_in = choice == BUILT_IN || *option.choice == NetworkChoice::Default;
    if built_in && option.key == "enhance" {
        return Err(refused(format!(
            "network `{choice}` requires a guide; a network that brightens has 3 channels"
        )));
    }
    if built_in {
        return Ok(());
    }
    if names.iter().any(|name| name == choice) {
        return Model::check(choice, folders).map_err(|error| {
            refused(error.to_string())
                .hint("The server's administrator can mend it; `fled models` checks the networks.")
        });
    }
    let words = option.words.iter().chain([&NetworkChoice::Default]);
    let words = words.map(NetworkChoice::as_str);
    let known: Vec<_> = words.chain(names.iter().map(String::as_str)).collect();
    let message = format!("`{choice}` is unknown; choose one of {}", known.join(", "));
    Err(refused(message)
        .hint("The server's administrator can add ONNX files to its folder of networks."))
}

fn bad_option(error: &OptionsError) -> Problem {
    Problem::unprocessable("bad_option", error.to_string())
        .pointer(below("options", &below(&error.key, "")))
        .hint("See /v1/options for the options, their ranges and presets.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_large_job_needs_memory_and_a_gpu_unless_it_names_the_processor() {
        let needs = |preset: Preset, adapter: &str, engine| {
            let options = Options { adapter: adapter.to_owned(), ..preset.options() };
            let needs = Order { preset, options, priority: Priority::of(0) }.needs(engine);
            (needs.gpu, needs.memory > 0)
        };
        for large in [Preset::High, Preset::Paper] {
            assert_eq!(needs(large, "auto", Engine::Postgres), (true, true));
            assert_eq!(needs(large, "some card", Engine::Postgres), (true, true));
            assert_eq!(needs(large, PROCESSOR, Engine::Postgres), (false, true));
            assert_eq!(needs(large, "auto", Engine::Sqlite), (false, false), "one machine");
        }
        assert_eq!(needs(Preset::Auto, "auto", Engine::Postgres), (false, false));
    }
}
