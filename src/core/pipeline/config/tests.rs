//! Options as users write them.

use super::*;

#[test]
fn what_a_kernel_explains_is_not_deblurred_for_training_unless_asked_for() {
    let with = |shake, train_on| Options {
        shake,
        train_on,
        ..Options::default()
    };
    let auto = with(ShakeModel::Late, TrainOn::Auto);
    assert!(auto.trains_on_enhanced(true) && !auto.trains_on_enhanced(false));
    assert!(!auto.never_trains_on_deblurred());
    assert!(with(ShakeModel::Kernel, TrainOn::Auto).never_trains_on_deblurred());
    assert!(!with(ShakeModel::Kernel, TrainOn::Deblurred).trains_on_enhanced(true));
    assert!(with(ShakeModel::Off, TrainOn::Enhanced).trains_on_enhanced(false));
}

#[test]
fn late_kernels_wait_for_the_second_round_and_for_views_that_tell() {
    let late = |round, tells| ShakeModel::Late.explains(round, tells);
    assert!(!late(1, true) && !late(2, false) && late(2, true));
    assert!(ShakeModel::Kernel.explains(1, false) && !ShakeModel::Off.explains(2, true));
}

#[test]
fn assignments_take_numbers_words_and_booleans() {
    let options = Options::default();
    assert_eq!(
        options.with_assignment("rounds=3").expect("valid").rounds,
        3
    );
    assert_eq!(
        options
            .with_assignment("held_out=5")
            .expect("valid")
            .held_out,
        "5"
    );
    assert_eq!(
        options.with_assignment("noise=off").expect("valid").noise,
        NoiseMode::Off
    );
    assert!(
        !options
            .with_assignment("resolution_schedule=false")
            .expect("valid")
            .resolution_schedule
    );
    assert_eq!(
        options
            .with_assignment("target=10,0.8")
            .expect("valid")
            .target,
        "10,0.8"
    );
}

#[test]
fn every_nth_view_may_be_a_number_or_a_string_in_json() {
    let read = |value: serde_json::Value| {
        let overrides = serde_json::Map::from_iter([("held_out".to_owned(), value)]);
        Options::default()
            .with_overrides(&overrides)
            .map(|options| options.held_out)
    };
    assert_eq!(read(5.into()).expect("valid"), "5");
    assert_eq!(read("a,b".into()).expect("valid"), "a,b");
    assert!(
        read(true.into())
            .expect_err("no list")
            .to_string()
            .contains("expected a number or a string")
    );
}

#[test]
fn an_unknown_key_or_bad_value_names_the_key() {
    let options = Options::default();
    assert_eq!(
        options.with_assignment("round=3").expect_err("unknown").key,
        "round"
    );
    assert_eq!(
        options.with_assignment("rounds=0").expect_err("range").key,
        "rounds"
    );
    assert_eq!(
        options
            .with_assignment("dropout=0.6")
            .expect_err("range")
            .key,
        "dropout"
    );
    assert_eq!(
        options.with_assignment("noise=loud").expect_err("enum").key,
        "noise"
    );
    let unguided = Options {
        guide: Guide::None,
        ..options.clone()
    };
    assert_eq!(
        unguided
            .with_assignment("deblur_unguided=a")
            .expect_err("both")
            .key,
        "deblur_unguided"
    );
    let aimed = Options {
        target: "10,0.8".to_owned(),
        ..options
    };
    assert_eq!(
        aimed.with_assignment("enhance=a").expect_err("both").key,
        "target"
    );
}
