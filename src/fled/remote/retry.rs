//! `fled retry`: lets a job of a service that ended go on.

use fled_core::pipeline::config::{Options, Preset};
use serde_json::{Map, Value, json};

use super::Remote;
use crate::failure::Failure;

/// Arguments of `fled retry`.
#[derive(clap::Args)]
pub struct Args {
    /// The job's id, as `fled submit` printed it.
    job: String,
    #[command(flatten)]
    remote: super::Args,
    /// One option over those that the job has; may be repeated. Only what it makes stale is done
    /// again.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    assignments: Vec<String>,
}

/// Queues the job again.
///
/// # Errors
/// [`Failure`] in the service's own words, also where the job has not ended.
pub fn main(args: &Args) -> Result<(), Failure> {
    let remote = Remote::new(&args.remote)?;
    let options = assigned(Preset::Standard, &args.assignments)?;
    let body = (!options.is_empty()).then(|| json!({ "options": options }));
    let state = remote.order(&args.job, "retry", body.as_ref())?;
    eprintln!("the job is {state}; `fled watch` shows it");
    Ok(())
}

/// Options that are assigned, by their keys, with the types that they have. A typo is told before
/// anything is sent.
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
