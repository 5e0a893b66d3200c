//! `metrics.json`: the rounds so far and the facts of the run.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::config::{Deliver, Options};
use super::context::Context;
use super::decide::Decision;
use super::error::PipelineError;
use super::tools::{Networks, Tools};
use crate::deblur::RestorerInfo;
use crate::event::Event;
use crate::metrics::{Report, RoundMetrics};
use crate::poses::Poses;

/// The report of a run that has not finished a round.
pub fn begin(
    decision: &Decision<'_>,
    tools: &Tools<'_>,
    networks: &Networks,
    poses: &Poses,
) -> Report {
    let model = |info: &RestorerInfo| {
        let RestorerInfo { id, sha256, provider, .. } = info;
        format!("{id} sha256:{sha256} on {provider}")
    };
    let models = networks.named().map(|(option, info)| (option.to_owned(), model(info)));
    let by = &poses.normalisation;
    Report {
        rounds: Vec::new(),
        best_round: 1,
        registered: poses.registered as u32,
        views: poses.total as u32,
        shaken_views: None,
        capture_shake: None,
        exposure: None,
        detail: decision.detail.clone(),
        expected_seconds: None,
        in_effect: BTreeMap::new(),
        stages: BTreeMap::new(),
        adapter: tools.device.to_string(),
        models: models.collect(),
        fallbacks: tools.fallbacks.clone(),
        poses: facts(poses),
        scene_offset: by.left_out.then(|| by.offset.to_array()),
        seed: decision.asked.seed,
        config: json!(decision.asked),
    }
}

/// Records the options that the device or a verdict on the capture changed.
pub fn change(report: &mut Report, asked: &Options, in_effect: &Options) {
    if let (Value::Object(asked), Value::Object(used)) = (json!(asked), json!(in_effect)) {
        let changed = used.into_iter().filter(|(key, value)| asked.get(key) != Some(value));
        report.in_effect = changed.collect();
    }
}

/// Records that the next rounds have other poses.
pub fn place(report: &mut Report, poses: &Poses) {
    report.registered = poses.registered as u32;
    report.poses = facts(poses);
}

fn facts(poses: &Poses) -> BTreeMap<String, Value> {
    let facts = [
        ("source", json!(poses.source)),
        ("rung", json!(poses.strategy.map(String::from))),
        ("registered", json!(poses.registered)),
        ("total", json!(poses.total)),
        ("points", json!(poses.points.len())),
        ("mean_reprojection_error_px", json!(poses.mean_reprojection_error)),
        ("mean_track", json!(poses.mean_track)),
        ("low_confidence", json!(poses.low_confidence)),
    ];
    // Given poses are not judged and have no verdicts.
    let said = (!poses.verdicts.is_empty()).then(|| ("verdicts", json!(poses.verdicts)));
    facts.into_iter().chain(said).map(|(name, value)| (name.to_owned(), value)).collect()
}

/// Adds a finished round and reports it.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn add_round(
    context: &mut Context<'_>,
    report: &mut Report,
    metrics: RoundMetrics,
    deliver: Deliver,
) -> Result<(), PipelineError> {
    report.rounds.push(metrics.clone());
    report.best_round = delivered_round(&report.rounds, deliver);
    write(context, report)?;
    context.sink.event(&Event::RoundFinished { metrics: Box::new(metrics) });
    Ok(())
}

/// Writes the report with the time that each stage has taken so far.
///
/// # Errors
/// [`PipelineError::Io`].
pub fn write(context: &Context<'_>, report: &mut Report) -> Result<(), PipelineError> {
    let stages = context.clock.stages();
    report.stages =
        stages.iter().map(|(stage, seconds)| (stage.name().to_owned(), *seconds)).collect();
    let workspace = context.workspace;
    workspace.write_json(&workspace.folder().metrics(), report)
}

/// The round that is delivered if none follows: the last one, or the last before the first one that
/// is worse than its predecessor.
pub fn delivered_round(rounds: &[RoundMetrics], deliver: Deliver) -> u32 {
    let counts = |round: &&RoundMetrics| deliver == Deliver::Last || !round.worse_than_previous;
    rounds.iter().take_while(counts).last().map_or(1, |round| round.round)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounds(worse: &[bool]) -> Vec<RoundMetrics> {
        let round = |(number, worse): (u32, &bool)| {
            serde_json::from_value(json!({
                "round": number, "seconds": 1, "gaussians": 9, "steps": 9, "steps_per_second": 9,
                "records": [], "noise_sigma": {}, "sharpness": {}, "mean_brightness": 0.5,
                "clipped": 0, "noise_ceiling_db": 30, "non_finite_gradients": 0,
                "anchor": { "alpha": 1, "gamma": 1 }, "worse_than_previous": worse
            }))
            .expect("a round")
        };
        (1..).zip(worse).map(round).collect()
    }

    #[test]
    fn the_best_round_or_the_last_is_delivered() {
        let cases: [(&[bool], u32, u32); 4] = [
            (&[false], 1, 1),
            (&[false, false], 2, 2),
            (&[false, true], 1, 2),
            (&[false, true, false], 1, 3),
        ];
        for (worse, best, last) in cases {
            let rounds = rounds(worse);
            assert_eq!(delivered_round(&rounds, Deliver::Best), best, "{worse:?}");
            assert_eq!(delivered_round(&rounds, Deliver::Last), last, "{worse:?}");
        }
    }
}
