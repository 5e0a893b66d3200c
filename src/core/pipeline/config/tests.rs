//! Tests of options as users write them.

use super::*;

#[test]
fn views_with_a_kernel_train_as_enhanced_by_default() {
    let with = |shake, train_on| Options { shake, train_on, ..Options::default() };
    let auto = with(ShakeModel::Late, TrainOn::Auto);
    assert!(auto.trains_on_enhanced(true) && !auto.trains_on_enhanced(false));
    assert!(!auto.needs_no_network());
    assert!(with(ShakeModel::Kernel, TrainOn::Auto).needs_no_network());
    assert!(with(ShakeModel::Off, TrainOn::Enhanced).needs_no_network());
    assert!(!with(ShakeModel::Late, TrainOn::Enhanced).needs_no_network());
    assert!(!with(ShakeModel::Kernel, TrainOn::Deblurred).trains_on_enhanced(true));
    assert!(with(ShakeModel::Off, TrainOn::Enhanced).trains_on_enhanced(false));
}

#[test]
fn late_kernels_are_for_views_found_shaken() {
    assert!(ShakeModel::Late.has_kernel(true) && !ShakeModel::Late.has_kernel(false));
    assert!(ShakeModel::Kernel.has_kernel(false) && !ShakeModel::Off.has_kernel(true));
}

#[test]
fn assignments_take_numbers_words_and_booleans() {
    let options = Options::default();
    assert_eq!(options.with_assignment("rounds=3").expect("valid").round_count(), 3);
    assert_eq!(options.with_assignment("held_out=5").expect("valid").held_out, "5");
    assert_eq!(options.with_assignment("noise=off").expect("valid").noise, NoiseMode::Off);
    assert!(!options.with_assignment("late_views=false").expect("valid").late_views);
    assert_eq!(options.with_assignment("target=10,0.8").expect("valid").target, "10,0.8");
}

#[test]
fn every_nth_view_may_be_a_number_or_a_string_in_json() {
    let read = |value: serde_json::Value| {
        let overrides = serde_json::Map::from_iter([("held_out".to_owned(), value)]);
        Options::default().with_overrides(&overrides).map(|options| options.held_out)
    };
    assert_eq!(read(5.into()).expect("valid"), "5");
    assert_eq!(read("a,b".into()).expect("valid"), "a,b");
    assert!(
        read(true.into())
            .expect_err("no list")
            .to_string()
            .contains("must be a number or a string")
    );
}

#[test]
fn no_current_option_is_retired() {
    let all = serde_json::to_value(Options::default()).expect("JSON");
    for key in all.as_object().expect("object").keys() {
        assert!(!Options::is_retired(key), "{key}");
    }
}

#[test]
fn an_unknown_key_or_bad_value_names_the_key() {
    let options = Options::default();
    assert_eq!(options.with_assignment("round=3").expect_err("unknown").key, "round");
    assert_eq!(options.with_assignment("rounds=0").expect_err("range").key, "rounds");
    assert_eq!(options.with_assignment("dropout=0.1").expect_err("gone").key, "dropout");
    assert_eq!(options.with_assignment("noise=loud").expect_err("enum").key, "noise");
    let aimed = Options { target: "10,0.8".to_owned(), ..options };
    assert_eq!(aimed.with_assignment("enhance=a").expect_err("both").key, "target");
}

#[test]
fn stored_options_that_no_longer_exist_are_dropped() {
    let stored = serde_json::json!({ "rounds": 3, "dropout": 0.0, "view_colour": false });
    let known = Options::known(&stored);
    assert_eq!(serde_json::json!(known), serde_json::json!({ "rounds": 3 }));
    let options = Options::default().with_overrides(&known).expect("valid");
    assert_eq!(options.round_count(), 3);
    let whole = serde_json::to_value(&options).expect("JSON");
    assert_eq!(serde_json::json!(Options::known(&whole)), whole);
}

#[test]
fn a_message_names_the_options_own_range() {
    let refused = |assignment: &str| {
        Options::default().with_assignment(assignment).expect_err("refused").to_string()
    };
    assert_eq!(
        refused("rounds=two"),
        "option `rounds`: must be a whole number from 1 to 8, or `auto`"
    );
    assert_eq!(refused("sh_degree=-1"), "option `sh_degree`: must be a whole number from 0 to 3");
    assert_eq!(refused("rounds=9"), "option `rounds`: 9 is outside 1..=8");
    let schema = serde_json::to_value(schemars::schema_for!(Options)).expect("a schema");
    for (key, low, high) in RANGES {
        let own = &schema["properties"][key];
        let number = own.get("anyOf").map_or(own, |forms| &forms[0]);
        assert_eq!((&number["minimum"], &number["maximum"]), (&low.into(), &high.into()), "{key}");
    }
}
