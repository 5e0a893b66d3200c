use serde_json::{Value, json};

use super::*;

/// A suite of one capture and several configurations, modified by `change`.
fn suite(change: impl Fn(&mut Value)) -> Result<Suite, String> {
    let mut content = json!({
        "question": "Does it help?",
        "preset": "preview",
        "seeds": 2,
        "set": {"size": 128},
        "inside": true,
        "captures": [{
            "name": "fox",
            "materials": {"dark": "fox/dark", "sharp": "/elsewhere/sharp"},
            "truth": "fox/truth"
        }],
        "configurations": [
            {"name": "plain", "set": {"rounds": 1, "steps": 500}},
            {"name": "fled"},
            {"name": "as long", "set": {"rounds": 1}, "seconds_of": "fled"},
            {"name": "sharp", "material": "sharp"}
        ],
        "gain": {"of": "fled", "over": "plain", "ceiling": "sharp"}
    });
    change(&mut content);
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("suite.json");
    std::fs::write(&path, content.to_string()).expect("written");
    let prefix = format!("{}/", folder.path().display());
    let mut suite = Suite::read(&path).map_err(|error| error.to_string().replace(&prefix, ""))?;
    for capture in &mut suite.captures {
        capture.truth = relative(&capture.truth, folder.path());
        for path in capture.materials.values_mut() {
            *path = relative(path, folder.path());
        }
    }
    Ok(suite)
}

fn relative(path: &Path, folder: &Path) -> PathBuf {
    path.strip_prefix(folder).unwrap_or(path).to_owned()
}

#[test]
fn paths_are_relative_and_omitted_keys_have_defaults() {
    let read = suite(|content| {
        content.as_object_mut().expect("object").remove("seeds");
    })
    .expect("a suite");
    let fox = &read.captures[0];
    assert_eq!(fox.truth, Path::new("fox/truth"));
    let material = |at: usize| read.material(fox, &read.configurations[at]);
    assert_eq!(material(0), Some(Path::new("fox/dark")));
    assert_eq!(material(3), Some(Path::new("/elsewhere/sharp")));
    assert_eq!((read.seeds, read.material.as_str()), (1, "dark"));
}

#[test]
fn an_error_names_the_wrong_key() {
    type Change = fn(&mut Value);
    let faults: [(Change, &str); 13] = [
        (|c| c["seed"] = json!(1), "unknown field `seed`"),
        (|c| c["captures"][0]["gt"] = json!("a"), "unknown field `gt`"),
        (|c| c["configurations"][0]["sets"] = json!({}), "unknown field `sets`"),
        (|c| c["gain"]["from"] = json!("a"), "unknown field `from`"),
        (|c| c["preset"] = json!("fast"), "unknown variant `fast`"),
        (|c| c["seeds"] = json!(0), "`seeds` is 0"),
        (
            |c| c["configurations"][1]["name"] = json!("plain"),
            "`configurations`: two are named `plain`",
        ),
        (|c| c["configurations"] = json!([]), "`configurations` is empty"),
        (
            |c| c["configurations"][3]["material"] = json!("shaken"),
            "`materials` of `fox`: there is no `shaken`, which `sharp` is given",
        ),
        (|c| c["configurations"][1]["set"] = json!({"seed": 3}), "`set.seed` of `fled`"),
        (
            |c| c["gain"]["over"] = json!("nothing"),
            "`gain.over`: no configuration is named `nothing`",
        ),
        (
            |c| c["configurations"][0]["seconds_of"] = json!("fled"),
            "`seconds_of` of `plain`: the first configuration",
        ),
        (|c| c["set"] = json!([]), "invalid type: sequence, expected a map"),
    ];
    for (change, fault) in faults {
        let message = suite(change).expect_err(fault);
        assert!(message.starts_with("suite.json: "), "{message}");
        assert!(message.contains(fault), "{fault} in {message}");
    }
}

#[test]
fn a_time_needs_its_run_and_one_of_the_same_speed() {
    let read = suite(|_| ()).expect("a suite");
    let timing = read.timing(&read.configurations[2]).expect("a timing");
    assert_eq!(timing.time_of.name, "fled");
    assert_eq!(timing.rate_of.name, "plain");
    assert!(read.timing(&read.configurations[1]).is_none());

    type Change = fn(&mut Value);
    let faults: [(Change, &str); 4] = [
        (
            |c| c["configurations"][2]["seconds_of"] = json!("other"),
            "no configuration is named `other`",
        ),
        (
            |c| c["configurations"][2]["seconds_of"] = json!("as long"),
            "`as long` has `seconds_of` itself",
        ),
        (
            |c| c["configurations"][2]["set"] = json!({"rounds": 1, "steps": 5}),
            "`set.steps` says them too",
        ),
        (
            |c| c["configurations"][2]["set"] = json!({"rounds": 3}),
            "no configuration without it has the same",
        ),
    ];
    for (change, fault) in faults {
        let message = suite(change).expect_err(fault);
        assert!(message.contains("`seconds_of` of `as long`: "), "{message}");
        assert!(message.contains(fault), "{fault} in {message}");
    }
}

#[test]
fn a_selection_keeps_the_first_and_its_dependencies() {
    let names = |only: &[&str]| {
        let selection = Selection {
            only: only.iter().map(|&name| name.to_owned()).collect(),
            seeds: Some(5),
            ..Selection::default()
        };
        let selected = suite(|_| ()).expect("a suite").selected(&selection);
        let selected = selected.expect("known names");
        assert_eq!(selected.seeds, 5);
        let names = selected.configurations.into_iter().map(|c| c.name);
        names.collect::<Vec<_>>().join(", ")
    };
    assert_eq!(names(&[]), "plain, fled, as long, sharp");
    assert_eq!(names(&["sharp"]), "plain, sharp");
    assert_eq!(names(&["as long"]), "plain, fled, as long");

    let selection = Selection { captures: vec!["hare".to_owned()], ..Selection::default() };
    let unknown = suite(|_| ()).expect("a suite").selected(&selection);
    let message = unknown.expect_err("no hare").to_string();
    assert_eq!(message, "no capture is named `hare`; there are fox");
    let none = suite(|c| c["captures"] = json!([])).expect("a suite");
    let message = none.selected(&Selection::default()).expect_err("nothing");
    assert!(message.to_string().contains("no `captures`"), "{message}");
}

#[test]
fn captures_may_come_from_a_separate_list() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("captures.json");
    let list = |materials: Value| json!([{"name": "a", "materials": materials, "truth": "t"}]);
    let both = list(json!({"dark": "d", "sharp": "s"}));
    std::fs::write(&path, both.to_string()).expect("written");
    let read = suite(|_| ()).expect("a suite").with_captures_of(&path);
    assert_eq!(read.expect("a list").captures[0].truth, folder.path().join("t"));
    std::fs::write(&path, list(json!({"dark": "d"})).to_string()).expect("written");
    let lacking = suite(|_| ()).expect("a suite").with_captures_of(&path);
    let message = lacking.expect_err("no sharp").to_string();
    assert!(message.contains("there is no `sharp`"), "{message}");
}

#[test]
fn an_assignment_has_the_type_of_its_option() {
    let assign = |text: &str| suite(|_| ()).expect("a suite").with_assignments(&[text.to_owned()]);
    let set = |text| assign(text).expect(text).set;
    assert_eq!(set("size=420")["size"], json!(420));
    assert_eq!(set("held_out=5")["held_out"], json!("5"));
    for (wrong, fault) in [("sise=1", "`sise`"), ("steps", "key=value"), ("seed=1", "`seeds`")] {
        let message = assign(wrong).expect_err(wrong).to_string();
        assert!(message.contains(fault), "{message}");
    }
}

#[test]
fn the_bundled_suites_are_valid_and_their_runs_differ() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tools/suites");
    for name in ["networks", "parts", "trainer"] {
        let path = folder.join(name).with_extension("json");
        let suite = Suite::read(&path).expect(name);
        let mut options = Vec::new();
        for configuration in &suite.configurations {
            let mut set = suite.set.clone();
            set.extend(configuration.set.clone());
            let of = suite.preset.options().with_overrides(&set);
            let of = of.unwrap_or_else(|error| panic!("{name}, {}: {error}", configuration.name));
            assert!(!options.contains(&of), "{name}, {}", configuration.name);
            options.push(of);
        }
    }
}
