//! Tests of suites with a stub in place of fled.

pub mod made_up;
mod pretended;

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use super::outcome::SuiteRun;
use pretended::{Mischief, Pretended, runs};

#[test]
fn every_configuration_finishes_a_seed_before_the_next() {
    let (_, calls) = Pretended::new().well();
    // fled's 2 x 1000 steps took 200 s; at plain's 10 steps per second that makes 2000 steps.
    let seed = |seed: u32| {
        ["rounds=1 seed=S steps=100", "seed=S steps=1000", "rounds=1 seed=S steps=2000"]
            .into_iter()
            .flat_map(|set| ["fox", "hare"].map(|capture| format!("{capture}/dark: {set}")))
            .map(move |run| run.replace('S', &seed.to_string()))
    };
    assert_eq!(runs(&calls), seed(0).chain(seed(1)).collect::<Vec<_>>());
}

#[test]
fn every_run_is_judged_where_the_first_sees_the_scene() {
    let (summary, calls) = Pretended::new().well();
    let judged: Vec<&String> = calls.iter().filter(|line| line.starts_with("eval ")).collect();
    assert_eq!(judged.len(), 12);
    let name = |configuration: &str| {
        let mut of = summary.runs.iter();
        let run = of.find(|run| run.configuration == configuration && run.capture == "hare");
        run.and_then(SuiteRun::judged).expect("judged").run.clone()
    };
    let (plain, fled) = (name("plain"), name("fled"));
    let of = |run: &str| {
        let start = format!("eval out/runs/{run} --truth hare/truth --out out/evaluations/");
        let line = judged.iter().find(|line| line.starts_with(&start));
        line.expect(&start)[start.len() + 16..].to_owned()
    };
    assert_eq!(of(&plain), " --adapter auto --inside");
    assert_eq!(of(&fled), format!(" --adapter auto --seen-from out/runs/{plain} --inside"));
}

#[test]
fn recorded_runs_are_not_repeated() {
    let pretended = Pretended::new();
    let (first, _) = pretended.well();
    let (again, calls) = pretended.well();
    assert_eq!((again, calls), (first.clone(), vec![]));
    let (finished, _) = pretended.done(None);
    assert_eq!(finished.expect("a suite"), first);
    let work = fs::read_dir(pretended.top().join("out/runs")).expect("runs");
    let work = work.filter(|run| run.as_ref().expect("entry").path().join("work").exists());
    assert_eq!(work.count(), 0, "only a resumed run reads it");
}

/// The number of runs and evaluations started after the suite changed.
fn started_after(change: impl Fn(&mut Pretended)) -> (usize, usize) {
    let mut pretended = Pretended::new();
    pretended.well();
    change(&mut pretended);
    let (_, calls) = pretended.well();
    let evaluations = calls.iter().filter(|line| line.starts_with("eval "));
    (runs(&calls).len(), evaluations.count())
}

#[test]
fn only_inputs_of_a_run_invalidate_its_record() {
    let write = |pretended: &Pretended, path: &str| {
        fs::write(pretended.top().join(path), "another").expect("file");
    };
    assert_eq!(started_after(|p| write(p, "program")), (12, 12));
    assert_eq!(started_after(|p| write(p, "fox/dark/1.png")), (6, 6));
    assert_eq!(started_after(|p| write(p, "fox/truth/1.png")), (0, 6));
    assert_eq!(started_after(|p| p.content["set"] = json!({"size": 100})), (12, 12));
    assert_eq!(started_after(|p| p.content["inside"] = json!(false)), (0, 12));
    assert_eq!(started_after(|p| p.content["seeds"] = json!(3)), (6, 6));
    assert_eq!(started_after(|p| p.content["question"] = json!("?")), (0, 0));
    // Another name, or an option set to its default, gives the same run.
    assert_eq!(
        started_after(|p| {
            p.content["captures"][0]["name"] = json!("vixen");
            p.content["configurations"][2]["set"] = json!({"steps": 1000, "rounds": "auto"});
        }),
        (0, 0)
    );
    assert_eq!(
        started_after(|p| {
            p.machine.insert("adapter".to_owned(), "another".to_owned());
        }),
        (12, 12)
    );
}

#[test]
fn a_changed_network_file_invalidates_its_runs() {
    let network = |pretended: &mut Pretended, golden: &str| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/onnx");
        let path = pretended.top().join("own.onnx");
        fs::copy(folder.join(golden), &path).expect("copied");
        pretended.content["configurations"][2]["set"] = json!({"deblur": path});
    };
    let mut pretended = Pretended::new();
    network(&mut pretended, "identity3.onnx");
    pretended.well();
    network(&mut pretended, "root3.onnx");
    let (_, calls) = pretended.well();
    assert_eq!(runs(&calls).len(), 4);
}

#[test]
fn a_failed_run_is_reported_and_repeated() {
    let pretended = Pretended::new();
    let fails: Mischief<'_> = &|line| {
        let bad = line.starts_with("run fox") && line.contains("seed=1 --set steps=1000");
        bad.then(|| "no poses".to_owned())
    };
    let (outcome, _) = pretended.done(Some(fails));
    let summary = outcome.expect("the others go on");
    let text = summary.markdown();
    assert!(text.contains("- failed: fox, fled, seed 1: no poses"), "{text}");
    assert!(
        text.contains("- failed: fox, as long, seed 1: the runs are not there"),
        "its time is not known: {text}"
    );
    assert!(text.contains("| 1, 1 failed |"), "{text}");
    let (finished, _) = pretended.done(None);
    let text = finished.expect("a suite").markdown();
    assert!(text.contains("- failed: fox, fled, seed 1: no poses"), "{text}");

    let (summary, calls) = pretended.well();
    assert_eq!(runs(&calls).len(), 2, "{calls:?}");
    assert!(!summary.markdown().contains("failed"));
}

#[test]
fn a_run_without_a_readable_result_has_failed() {
    let pretended = Pretended::new();
    let evaluations = pretended.top().join("out/evaluations");
    let in_the_way: Mischief<'_> = &|line| {
        let judges = line.starts_with("eval ") && line.contains("fox/truth");
        let out = line.split(' ').nth(5).filter(|_| judges)?;
        let name = out.rsplit('/').next().expect("a name");
        let file = evaluations.join(name).join("evaluation.json");
        fs::create_dir_all(file).expect("a folder in the file's place");
        None
    };
    let (outcome, _) = pretended.done(Some(in_the_way));
    let text = outcome.expect("the others go on").markdown();
    assert!(text.contains("- failed: fox, plain, seed 0: "), "{text}");
    assert!(text.contains("| hare | plain | 20.60 |"), "{text}");
}

#[test]
fn without_the_first_configuration_nothing_can_be_judged() {
    let fails: Mischief<'_> = &|line| {
        let first =
            line.starts_with("run fox") && line.contains("rounds=1 --set seed=0 --set steps=100");
        first.then(|| "ended".to_owned())
    };
    let (outcome, _) = Pretended::new().done(Some(fails));
    let text = outcome.expect("the others go on").markdown();
    assert!(text.contains("- failed: fox, plain, seed 0: ended"), "{text}");
    assert!(
        text.contains("- failed: fox, fled, seed 0: no run of the first configuration"),
        "{text}"
    );
}

#[test]
fn a_run_whose_inputs_changed_is_not_recorded() {
    for file in ["program", "fox/dark/1.png"] {
        let pretended = Pretended::new();
        let path = pretended.top().join(file);
        let swaps: Mischief<'_> = &|_| {
            fs::write(&path, "another").expect("file");
            None
        };
        let (outcome, calls) = pretended.done(Some(swaps));
        let message = outcome.expect_err("changed").to_string();
        assert!(message.contains("changed while a run was made of it"), "{message}");
        assert_eq!(calls.len(), 1);
        fs::write(&path, "another").expect("file");
        let (finished, _) = pretended.done(None);
        assert_eq!(finished.expect("a suite").runs, []);
    }
}

#[test]
fn invalid_options_are_reported_before_the_first_run() {
    let wrong = |change: &dyn Fn(&mut Value)| {
        let mut pretended = Pretended::new();
        change(&mut pretended.content);
        let (outcome, calls) = pretended.done(Some(&|_| None));
        assert_eq!(calls, Vec::<String>::new());
        outcome.expect_err("wrong").to_string()
    };
    let option = wrong(&|c| c["configurations"][2]["set"] = json!({"round": 2}));
    assert!(option.starts_with("fox, fled, seed 0: option `round`"), "{option}");
    let network = wrong(&|c| c["set"] = json!({"deblur": "no-such-network"}));
    assert!(network.contains("`deblur`: `no-such-network` is neither an ONNX file"), "{network}");
    let truth = wrong(&|c| c["captures"][1]["truth"] = json!("nowhere"));
    assert!(truth.contains("nowhere: No such file"), "{truth}");
}

#[test]
fn builds_do_not_share_poses() {
    let pretended = Pretended::new();
    let cache = |calls: &[String]| {
        let mut words = calls[0].split(' ').skip_while(|word| *word != "--cache");
        words.nth(1).expect("a folder").to_owned()
    };
    let (_, first) = pretended.well();
    fs::write(pretended.top().join("program"), "build 2").expect("file");
    let (_, second) = pretended.well();
    assert!(cache(&first).starts_with("out/poses/"));
    assert_ne!(cache(&first), cache(&second));
}

#[test]
fn tables_show_scores_differences_and_shares_of_the_ceiling() {
    let (summary, _) = Pretended::new().well();
    let text = summary.markdown();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "What two rounds bring");
    for expected in [
        "| fox | plain | 20.60 | 21.60 | 15.60 | 0.2060 | - | 22.60 | 7 of 900 | 100 | 10 | 23 | 2 |",
        "| hare | fled | 21.50 | 22.50 | 16.50 | 0.2150 | - | 23.50 | 7 of 900 | 2000 | 200 | 23 | 2 |",
        "| mean | as long | 22.50 | 23.50 | 17.50 | 0.2250 | - | 24.50 | 7 of 900 | 2000 | 200 | 23 | 2 |",
        "| fled | registered | +0.90 [+0.90, +0.90] | +0.90 [+0.90, +0.90] | +0.0090 [+0.0090, +0.0090] | - | +0.90 [+0.90, +0.90] | 2 | 2 |",
        "From fewer than 6 captures or 2 seeds no claim can be made.",
        "| fox | +0.90 | +1.90 | +0.47 |",
        "| mean | - | - | +0.47 [+0.47, +0.47] |",
    ] {
        assert!(lines.contains(&expected), "{expected}\nin\n{text}");
    }
    let as_json = serde_json::to_value(&summary).expect("JSON");
    assert_eq!(as_json["differences"].as_array().expect("a list").len(), 16);
    assert_eq!(as_json["runs"][0]["outcome"]["finished"]["steps"], 100);
}
