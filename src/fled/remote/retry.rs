//! `fled retry`: continues a finished job of a service.

use fled_core::pipeline::config::{Options, Preset};
use serde_json::{Map, Value, json};

use super::Remote;
use crate::failure::Failure;

/// Arguments of `fled retry`.
#[derive(clap::Args)]
pub struct Args {
    /// ID of the job, as printed by `fled submit`.
    job: String,
    #[command(flatten)]
    remote: super::Args,
    /// Overrides one option of the job; may be repeated. Only the work that it affects is repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
}

/// Queues the job again.
///
/// # Errors
/// [`Failure`] with the service's own message, including for a job that is not over.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let options = assigned(Preset::Standard, &args.assignments)?;
    let body = (!options.is_empty()).then(|| json!({ "options": options }));
    let state = remote.order(&args.job, "retry", body.as_ref())?;
    eprintln!("the job is {state}; follow it with `fled watch`");
    Ok(())
}

/// The assigned options by key, with their JSON types. A typo is reported before anything is sent.
pub fn assigned(preset: Preset, assignments: &[String]) -> Result<Map<String, Value>, Failure> {
    let mut options: Options = preset.options();
    let mut given = Map::new();
    for assignment in assignments {
        options = options.with_assignment(assignment)?;
        if let Some((key, _)) = assignment.split_once('=') {
            let all = serde_json::to_value(&options).unwrap_or_default();
            given.insert(key.trim().to_owned(), all[key.trim()].clone());
        }
    }
    Ok(given)
}
