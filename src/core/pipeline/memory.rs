//! How much memory a run needs, and smaller images or fewer Gaussians where the machine has less.

use super::config::{Options, Setting};
use super::views::working_size;
use crate::device::MemoryRoom;
use crate::reconstruct::device_bytes;

/// Bytes of a process without images and Gaussians: libraries, networks and their working memory.
const PROCESS: u64 = 300_000_000;
/// Floats a pixel of all views at the peak: between five and six sets of images in three colours
/// (dark, enhanced, deblurred, trained and rendered). 60 views of 560x420 px took 1.0 GB in all
/// (docs/results.md): with [`PROCESS`] that leaves a quarter to spare.
const FLOATS_PER_PIXEL: u64 = 17;
/// Share of a memory that a run may plan to fill.
const USABLE: f64 = 0.8;
/// Longest side of the images below which nothing gets smaller, px.
const LEAST_SIDE: u32 = 280;
/// Number of Gaussians below which nothing gets smaller.
const LEAST_CAP: u32 = 10_000;
/// Factors by which side and cap get smaller at a time.
const SIDE_FACTOR: f64 = 0.95;
const CAP_FACTOR: f64 = 0.8;

/// Bytes that a run needs at its peak.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Need {
    /// In main memory.
    pub host: u64,
    /// On the GPU; 0 without one.
    pub device: u64,
}

/// Options that fit into a machine's memory, or do not and are obeyed.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    pub options: Options,
    pub need: Need,
    /// What was made smaller, and what may not fit, one sentence each.
    pub warnings: Vec<String>,
}

/// The memory that a run needs over photographs of these sizes (width and height, px). `has_own`:
/// whether the device has memory of its own.
pub fn need(options: &Options, photographs: &[[usize; 2]], has_own: bool) -> Need {
    let side = options.longest_side() as usize;
    let pixels = photographs.iter().map(|&[width, height]| {
        let (width, height) = working_size(width, height, side);
        (width * height) as u64
    });
    let (all, largest) = pixels.fold((0, 0), |(sum, most), one| (sum + one, one.max(most)));
    let gaussians = u64::from(options.most_gaussians());
    let training = device_bytes(gaussians, options.sh_degree, largest, all);
    let images = PROCESS + FLOATS_PER_PIXEL * size_of::<f32>() as u64 * all;
    if has_own {
        Need { host: images, device: training }
    } else {
        Need { host: images + training, device: 0 }
    }
}

/// Makes images, and then the number of Gaussians, smaller until the run fits, where the options
/// leave them open.
pub fn fit(options: &Options, photographs: &[[usize; 2]], room: &MemoryRoom) -> Fit {
    let usable =
        |bytes: Option<u64>| bytes.map_or(u64::MAX, |bytes| (USABLE * bytes as f64) as u64);
    let (host, device) = (usable(room.host), usable(room.device));
    let need_of = |options: &Options| need(options, photographs, room.device.is_some());
    let exceeds = |options: &Options| {
        let need = need_of(options);
        need.host > host || need.device > device
    };
    let with_few = |options: &Options| {
        let cap = if options.cap.is_open() { Setting::Fitted(LEAST_CAP) } else { options.cap };
        Options { cap, ..options.clone() }
    };
    let mut fitted = options.clone();
    let longest = photographs.iter().flatten().max().map_or(u32::MAX, |&side| side as u32);
    // The images first: scenes of few Gaussians do not show what large ones have.
    while fitted.size.is_open()
        && fitted.longest_side() > LEAST_SIDE
        && (need_of(&fitted).host > host || exceeds(&with_few(&fitted)))
    {
        shrink_images(&mut fitted, longest);
    }
    // Fewer Gaussians than that would not help.
    let helps = fitted.cap.is_open() && !exceeds(&with_few(&fitted));
    while helps && exceeds(&fitted) {
        let cap = f64::from(fitted.most_gaussians()) * CAP_FACTOR;
        fitted.cap = Setting::Fitted((cap as u32).max(LEAST_CAP));
    }
    let warnings = warnings(options, &fitted, need_of(options), need_of(&fitted), room);
    Fit { need: need_of(&fitted), options: fitted, warnings }
}

/// Smaller images, with as many Gaussians a pixel where their number is open. `longest` is the
/// longest side of all photographs, px: images are never larger.
fn shrink_images(options: &mut Options, longest: u32) {
    let before = options.longest_side().min(longest);
    let side = ((f64::from(before) * SIDE_FACTOR) as u32 / 20 * 20).max(LEAST_SIDE.min(before));
    if options.cap.is_open() {
        let area = (f64::from(side) / f64::from(before)).powi(2);
        let cap = (f64::from(options.most_gaussians()) * area) as u32;
        options.cap = Setting::Fitted(cap.max(LEAST_CAP));
    }
    options.size = Setting::Fitted(side);
}

fn warnings(
    asked: &Options,
    fitted: &Options,
    wanted: Need,
    need: Need,
    room: &MemoryRoom,
) -> Vec<String> {
    let memories = [
        ("memory", wanted.host, need.host, room.host),
        ("memory on the GPU", wanted.device, need.device, room.device),
    ];
    let mut warnings = Vec::new();
    for (name, wanted, need, room) in memories {
        let Some(room) = room else { continue };
        let most = (USABLE * room as f64) as u64;
        let (of, all) = (gigabytes(wanted), gigabytes(room));
        if wanted > most {
            let to = if fitted == asked {
                "the options leave nothing to make smaller".to_owned()
            } else {
                let (side, cap) = (fitted.longest_side(), fitted.most_gaussians());
                format!("it has images of {side} px and at most {cap} Gaussians instead")
            };
            warnings.push(format!("the run needs about {of} of {name} and there are {all}: {to}"));
        }
        if need > most && fitted != asked {
            let of = gigabytes(need);
            warnings.push(format!("even so it needs about {of} of {name} and may run out"));
        }
    }
    warnings
}

impl Need {
    /// One sentence for the log.
    pub fn in_words(&self) -> String {
        let host = gigabytes(self.host);
        match self.device {
            0 => format!("the run needs about {host} of memory"),
            device => {
                format!("the run needs about {host} of memory and {} on the GPU", gigabytes(device))
            }
        }
    }
}

fn gigabytes(bytes: u64) -> String {
    format!("{:.1} GB", bytes as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::config::Preset;

    const GB: u64 = 1_000_000_000;

    fn photographs(count: usize) -> Vec<[usize; 2]> {
        vec![[4000, 3000]; count]
    }

    fn room(host: u64, device: u64) -> MemoryRoom {
        MemoryRoom { host: Some(host * GB), device: (device > 0).then_some(device * GB) }
    }

    #[test]
    fn a_run_that_fits_keeps_its_options() {
        let high = Preset::High.options();
        let fit = fit(&high, &photographs(60), &room(64, 24));
        assert_eq!((&fit.options, fit.warnings.len()), (&high, 0));
        assert!(fit.need.host > 8 * GB && fit.need.device > GB, "{:?}", fit.need);
        let said = fit.need.in_words();
        assert!(said.contains(" GB of memory and ") && said.ends_with("on the GPU"), "{said}");
        let unknown = MemoryRoom { host: None, device: None };
        assert_eq!(super::fit(&high, &photographs(1_000), &unknown).options, high);
    }

    #[test]
    fn little_memory_gives_smaller_images_with_as_many_gaussians_a_pixel() {
        let high = Preset::High.options();
        let fit = fit(&high, &photographs(60), &room(8, 24));
        let (side, cap) = (fit.options.longest_side(), fit.options.most_gaussians());
        assert!((800..1_400).contains(&side), "{side}");
        let density = |side: u32, cap: u32| f64::from(cap) / f64::from(side).powi(2);
        let kept = density(side, cap) / density(1_600, 1_000_000);
        assert!((kept - 1.0).abs() < 0.01, "{kept}");
        assert!(fit.need.host <= 8 * GB * 8 / 10 && fit.need.host > 5 * GB, "{:?}", fit.need);
        let [warning] = &fit.warnings[..] else { panic!("{:?}", fit.warnings) };
        assert!(warning.contains("of memory and there are 8.0 GB"), "{warning}");
        assert!(fit.options.size.is_open(), "a verdict on shake may still make them smaller");
    }

    #[test]
    fn photographs_below_the_asked_size_keep_as_many_gaussians_a_pixel() {
        let high = Preset::High.options();
        let fit = fit(&high, &[[1_000, 750]; 200], &room(8, 24));
        let (side, cap) = (fit.options.longest_side(), fit.options.most_gaussians());
        assert!((500..1_000).contains(&side), "{side}");
        let kept = f64::from(cap) / 1e6 / (f64::from(side) / 1e3).powi(2);
        assert!((kept - 1.0).abs() < 0.01, "{kept}");
    }

    #[test]
    fn a_small_gpu_gets_fewer_gaussians_and_large_images() {
        let high = Preset::High.options();
        let fit = fit(&high, &photographs(60), &room(64, 1));
        assert_eq!(fit.options.longest_side(), 1_600);
        assert!((100_000..900_000).contains(&fit.options.most_gaussians()), "{:?}", fit.options);
        assert!(fit.need.device <= GB * 8 / 10);
        assert!(fit.warnings[0].contains("of memory on the GPU"), "{:?}", fit.warnings);
    }

    #[test]
    fn given_numbers_are_obeyed_with_a_warning() {
        let (size, cap) = (Setting::Given(1_600), Setting::Given(1_000_000));
        let given = Options { size, cap, ..Preset::High.options() };
        let obeyed = fit(&given, &photographs(60), &room(4, 0));
        assert_eq!(obeyed.options, given);
        let [warning] = &obeyed.warnings[..] else { panic!("{:?}", obeyed.warnings) };
        assert!(warning.ends_with("the options leave nothing to make smaller"), "{warning}");
        // Fewer Gaussians would not make room for images of a given size.
        let open = Options { cap: Setting::Auto, ..given.clone() };
        assert_eq!(fit(&open, &photographs(60), &room(4, 0)).options, open);
        let fewer = fit(&open, &photographs(60), &room(12, 0)).options;
        assert_eq!(fewer.size, open.size, "only the cap was open");
        assert!((10_000..1_000_000).contains(&fewer.most_gaussians()), "{fewer:?}");
        // Smaller images than these are of no use.
        let many = fit(&Preset::High.options(), &photographs(2_000), &room(1, 0));
        assert_eq!(many.options.longest_side(), LEAST_SIDE);
        assert!(many.warnings[1].ends_with("may run out"), "{:?}", many.warnings);
    }
}
