//! Chooses how much detail a run trains, by its device.

use super::config::{Detail, Options, OptionsError};
use crate::device::{AUTO, DeviceFacts, PROCESSOR};
use crate::metrics::{ChosenDetail, DetailLevel};

/// Memory of a GPU's own from which it trains the detail `high`, bytes. A card sold with 6 GB
/// reports a little less than 6 GiB.
const HIGH_FROM: u64 = 6_000_000_000;

/// The options of a run on a device.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// The options, without `auto` for the detail.
    pub options: Options,
    /// What `auto` became; `None` if the options name the detail.
    pub detail: Option<ChosenDetail>,
}

/// Refuses options that ask for `high` and leave the device open, if that is no GPU.
///
/// # Errors
/// [`OptionsError`], which says how to train all the same.
pub fn check_detail(options: &Options, device: &DeviceFacts) -> Result<(), OptionsError> {
    if options.detail != Detail::High || device.is_gpu || options.adapter != AUTO {
        return Ok(());
    }
    let name = &device.name;
    let adapter = if device.is_processor { PROCESSOR } else { name };
    let message = format!(
        "`high` is for GPUs, and this machine has none; choose `standard`, or set \
         `adapter={adapter}` to train for hours on {name}"
    );
    Err(OptionsError { key: "detail".to_owned(), message })
}

/// Decides the detail that the options leave to the device. Numbers that the options give stay.
///
/// # Errors
/// As [`check_detail`].
pub fn choose(options: &Options, device: &DeviceFacts) -> Result<Chosen, OptionsError> {
    check_detail(options, device)?;
    if options.detail != Detail::Auto {
        return Ok(Chosen { options: options.clone(), detail: None });
    }
    let chosen = of_device(device);
    let detail = match chosen.level {
        DetailLevel::Standard => Detail::Standard,
        DetailLevel::High => Detail::High,
    };
    Ok(Chosen { options: Options { detail, ..options.clone() }, detail: Some(chosen) })
}

fn of_device(device: &DeviceFacts) -> ChosenDetail {
    let DeviceFacts { name, is_gpu, own_memory, .. } = device;
    let (level, because) = match own_memory {
        _ if !is_gpu => (DetailLevel::Standard, format!("{name} is not a GPU")),
        Some(bytes) if *bytes >= HIGH_FROM => {
            (DetailLevel::High, format!("{name} has {} of memory", gigabytes(*bytes)))
        }
        Some(bytes) => {
            let (has, needed) = (gigabytes(*bytes), gigabytes(HIGH_FROM));
            (DetailLevel::Standard, format!("{name} has {has} of memory, below {needed}"))
        }
        None => (DetailLevel::Standard, format!("{name} reports no memory of its own")),
    };
    ChosenDetail { level, because }
}

/// Rounded down: what is below a bound is shown below it.
fn gigabytes(bytes: u64) -> String {
    format!("{:.1} GB", (bytes as f64 / 1e8).floor() / 10.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::config::{Preset, Setting};

    fn device(is_gpu: bool, own_memory: Option<u64>) -> DeviceFacts {
        let name = "Some device".to_owned();
        DeviceFacts { name, is_gpu, own_memory, ..DeviceFacts::default() }
    }

    fn chosen(options: &Options, device: &DeviceFacts) -> (Options, ChosenDetail) {
        let chosen = choose(options, device).expect("auto is never refused");
        (chosen.options, chosen.detail.expect("it was left open"))
    }

    #[test]
    fn auto_is_high_on_a_gpu_with_memory_and_says_why() {
        let auto = Preset::Auto.options();
        let of = |device: &DeviceFacts| {
            let (options, ChosenDetail { level, because }) = chosen(&auto, device);
            assert_eq!(options.detail == Detail::High, level == DetailLevel::High);
            (level, because)
        };
        let cases = [
            (true, Some(24_000_000_000), DetailLevel::High, "Some device has 24.0 GB of memory"),
            (true, Some(HIGH_FROM), DetailLevel::High, "Some device has 6.0 GB of memory"),
            (
                true,
                Some(4_200_000_000),
                DetailLevel::Standard,
                "Some device has 4.2 GB of memory, below 6.0 GB",
            ),
            (
                true,
                Some(5_999_999_999),
                DetailLevel::Standard,
                "Some device has 5.9 GB of memory, below 6.0 GB",
            ),
            (true, None, DetailLevel::Standard, "Some device reports no memory of its own"),
            (false, None, DetailLevel::Standard, "Some device is not a GPU"),
            (false, Some(64_000_000_000), DetailLevel::Standard, "Some device is not a GPU"),
        ];
        for (is_gpu, memory, level, because) in cases {
            assert_eq!(of(&device(is_gpu, memory)), (level, because.to_owned()));
        }
    }

    #[test]
    fn what_auto_became_is_what_the_preset_of_that_name_has() {
        let large = device(true, Some(24_000_000_000));
        let (auto, small) = (Preset::Auto.options(), device(false, None));
        assert_eq!(chosen(&auto, &large).0, Preset::High.options());
        assert_eq!(chosen(&auto, &small).0, Preset::Standard.options());
        let high = Preset::High.options();
        assert_eq!((high.longest_side(), high.most_gaussians()), (1_600, 1_000_000));
        assert_eq!(high.steps_per_round() * high.round_count(), 7_000);
    }

    #[test]
    fn given_numbers_are_obeyed_whatever_the_device() {
        let given = Setting::Given;
        let (size, cap, steps, rounds) = (given(800), given(50_000), given(90), given(3));
        let options = Options { size, cap, steps, rounds, ..Preset::Auto.options() };
        let (chosen, _) = chosen(&options, &device(true, Some(24_000_000_000)));
        let numbers = (chosen.longest_side(), chosen.most_gaussians(), chosen.steps_per_round());
        assert_eq!((numbers, chosen.round_count()), ((800, 50_000, 90), 3));
    }

    #[test]
    fn high_without_a_gpu_must_name_the_device() {
        let high = Preset::High.options();
        let software = device(false, None);
        let processor = DeviceFacts { is_processor: true, ..software.clone() };
        let refused = choose(&high, &processor).expect_err("hours");
        assert_eq!(refused.key, "detail");
        assert!(refused.message.contains("choose `standard`, or set `adapter=cpu`"), "{refused}");
        let refused = choose(&high, &software).expect_err("hours");
        assert!(refused.message.contains("`adapter=Some device`"), "no AVX2: {refused}");
        let asked = Options { adapter: "cpu".to_owned(), ..high.clone() };
        let whole = Chosen { options: asked.clone(), detail: None };
        assert_eq!(choose(&asked, &processor), Ok(whole));
        assert!(choose(&high, &device(true, Some(2_000_000_000))).is_ok(), "a small GPU is obeyed");
        let standard = Preset::Standard.options();
        assert_eq!(choose(&standard, &device(true, None)).expect("obeyed").options, standard);
    }
}
