//! Options as users write them.

use super::*;

#[test]
fn what_shake_explains_is_not_deblurred_for_training_unless_asked_for() {
    let standard = Options {
        shake: ShakeModel::Kernel,
        ..Preset::Standard.options()
    };
    assert!(standard.trains_on_enhanced(1));
    assert!(
        !Options {
            shake: ShakeModel::Off,
            ..standard.clone()
        }
        .trains_on_enhanced(1)
    );
    assert!(
        !Options {
            train_on: TrainOn::Deblurred,
            ..standard.clone()
        }
        .trains_on_enhanced(1)
    );
    let forced = Options {
        train_on: TrainOn::Enhanced,
        shake: ShakeModel::Off,
        ..standard
    };
    assert!(forced.trains_on_enhanced(1) && !Preset::Paper.options().trains_on_enhanced(1));
}

#[test]
fn late_kernels_leave_the_first_round_to_the_network() {
    let late = Options {
        shake: ShakeModel::Late,
        ..Options::default()
    };
    assert_eq!(
        [1, 2, 3].map(|round| late.explains_shake(round)),
        [false, true, true]
    );
    assert_eq!(
        [1, 2].map(|round| late.trains_on_enhanced(round)),
        [false, true]
    );
    let one = Options {
        rounds: 1,
        ..late.clone()
    };
    assert!(
        one.explains_shake(1),
        "there is no second round to leave it to"
    );
    assert_eq!(*late.trained_on(1, "H", "D"), *"D");
    assert_eq!(*late.trained_on(2, "H", "D"), *"H");
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
