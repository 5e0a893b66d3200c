use glam::DVec3;

use super::super::fixtures::scattered;
use super::*;
use crate::camera::normalisation::Normalisation;

fn written(gaussians: &Gaussians, normalisation: Normalisation) -> String {
    let mut bytes = Vec::new();
    let scene = Scene { gaussians: gaussians.clone(), normalisation };
    write_to(&scene, Placement::default(), &mut bytes).expect("written");
    String::from_utf8(bytes).expect("text")
}

/// The numbers of an attribute, row after row.
fn numbers(text: &str, attribute: &str) -> Vec<f32> {
    let (_, rest) = text.split_once(&format!(" {attribute} = ")).expect("the attribute");
    let (line, _) = rest.split_once('\n').expect("a line");
    let words = line.split(['[', ']', '(', ')', ',', ' ']).filter(|word| !word.is_empty());
    words.map(|word| word.parse().expect("a number")).collect()
}

#[test]
fn every_number_is_found_again_with_y_up() {
    for degree in 0..=3 {
        let scene = scattered(50, 8.0, degree);
        let text = written(&scene, Normalisation::default());
        let turned = scene.turned_y_up();
        let of = |attribute: &str| numbers(&text, attribute);
        assert_eq!(of("positions"), turned.means.as_flattened());
        let scales = turned.log_scales.as_flattened().iter().map(|axis| axis.exp());
        assert_eq!(of("scales"), scales.collect::<Vec<_>>());
        let each = 0..turned.len();
        let rotations = each.clone().flat_map(|i| turned.rotation(i).map(|q| q as f32));
        assert_eq!(of("orientations"), rotations.collect::<Vec<_>>());
        let opacities = each.map(|i| turned.opacity(i) as f32);
        assert_eq!(of("opacities"), opacities.collect::<Vec<_>>());
        assert_eq!(of("radiance:sphericalHarmonicsCoefficients"), turned.sh);
        assert_eq!(of("radiance:sphericalHarmonicsDegree"), [degree as f32]);
        let (said, is) = (bytes_of(50, degree), text.len() as u64);
        assert!(said / 2 < is && is < 2 * said, "{said} {is}");
    }
}

#[test]
fn the_extent_holds_all_gaussians_and_no_more_than_their_reach() {
    let scene = scattered(50, 8.0, 0);
    let extent = numbers(&written(&scene, Normalisation::default()), "extent");
    let turned = scene.turned_y_up();
    let reach = REACH * (-1_f32).exp();
    for axis in 0..3 {
        let middles = turned.means.iter().map(|mean| mean[axis]);
        let least = middles.clone().reduce(f32::min).expect("some");
        let greatest = middles.reduce(f32::max).expect("some");
        assert!(extent[axis] < least && extent[axis] >= least - reach);
        assert!(extent[3 + axis] > greatest && extent[3 + axis] <= greatest + reach);
    }
}

#[test]
fn the_prim_above_carries_the_offset_that_positions_lack() {
    let scene = scattered(4, 1.0, 0);
    let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
    for left_out in [true, false] {
        let text = written(&scene, Normalisation { offset, scale: 0.0625, left_out });
        let is_noted = text.contains("double3 xformOp:translate = (512352,5412352,-64)\n");
        assert_eq!(is_noted, left_out);
        assert_eq!(text.contains("xformOpOrder"), left_out);
        let x = numbers(&text, "positions")[0];
        let world = scene.means[0][0] * 16.0 + if left_out { 0.0 } else { 512_352.0 };
        assert!((x - world).abs() < 0.04, "{x} {world}");
    }
}

#[test]
fn the_prim_above_carries_a_scale_that_multiplies_the_offset_too() {
    let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
    let normalisation = Normalisation { offset, scale: 0.0625, left_out: true };
    let scene = Scene { gaussians: scattered(4, 1.0, 0), normalisation };
    let mut bytes = Vec::new();
    write_to(&scene, Placement { scale: 2.5, ..Placement::default() }, &mut bytes)
        .expect("written");
    let text = String::from_utf8(bytes).expect("text");
    let node = "    double3 xformOp:translate = (1280880,13530880,-160)\n    double3 \
                xformOp:scale = (2.5,2.5,2.5)\n    uniform token[] xformOpOrder = \
                [\"xformOp:translate\", \"xformOp:scale\"]\n";
    assert!(text.contains(node) && text.contains("A unit of the world of the poses is 2.5 m."));
    assert_eq!(
        numbers(&text, "positions"),
        numbers(&written(&scene.gaussians, normalisation), "positions")
    );
}

#[test]
fn the_prim_above_stands_the_scene_upright() {
    let scene = Scene { gaussians: scattered(4, 1.0, 0), normalisation: Normalisation::default() };
    let mut bytes = Vec::new();
    let placement = Placement { up: DVec3::Z, ..Placement::default() };
    write_to(&scene, placement, &mut bytes).expect("written");
    let text = String::from_utf8(bytes).expect("text");
    // A quarter of a turn about x, its real part first.
    let [w, x, y, z] = numbers(&text, "xformOp:orient")[..] else { panic!("a quaternion") };
    let half = 0.5_f32.sqrt();
    assert!((w - half).abs() < 1e-6 && (x - half).abs() < 1e-6 && [y, z] == [0.0; 2], "{text}");
    assert!(text.contains("xformOpOrder = [\"xformOp:orient\"]"));
}

#[test]
fn non_finite_gaussians_are_left_out() {
    let mut scene = scattered(3, 1.0, 1);
    scene.means[1][2] = f32::NAN;
    let text = written(&scene, Normalisation::default());
    assert_eq!(numbers(&text, "opacities").len(), 2);
    assert!(!text.contains("NaN"));
}
