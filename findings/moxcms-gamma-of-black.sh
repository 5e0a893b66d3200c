#!/usr/bin/env bash
# moxcms 0.8.1 (Rust): the curve of a gamma gives black a light far below 0.
#
# An ICC curve of one entry is an exponent. `make_linear_evaluator` computes it through an approximate logarithm that has
# no case for 0, so black is -165,330,910 for a gamma of 1.8, which is ProPhoto's own profile as moxcms makes it, and -4
# for 2.0. Near 2.2 the value is as wrong, but small. The same exponent as a parametric curve gives 0, and so does the
# transform of whole pixels, which tabulates the curve in another way.
#
# Output seen with Rust 1.95, moxcms 0.8.1:
#   gamma 1.8: black is -165330910 by a curve of one entry, 0 by a parametric one
#   gamma 2.0: black is -4 by a curve of one entry, 0 by a parametric one
#   gamma 2.2: black is -0.0000000967756 by a curve of one entry, 0 by a parametric one
#   ProPhoto's black is -165330910 by its curve, [0.0, 0.0, 0.0] by a transform to sRGB
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cargo init --quiet --name check --vcs none
cargo add --quiet moxcms@=0.8.1
cat >src/main.rs <<'RUST'
use moxcms::{ColorProfile, Layout, ToneReprCurve, TransformOptions, curve_from_gamma};

fn black(curve: &ToneReprCurve) -> f32 {
    curve.make_linear_evaluator().unwrap().evaluate_value(0.0)
}

fn main() {
    for (gamma, is_wrong) in [(1.8, true), (2.0, true), (2.2, false)] {
        let of_entry = black(&curve_from_gamma(gamma));
        let parametric = black(&ToneReprCurve::Parametric(vec![gamma]));
        println!("gamma {gamma:.1}: black is {of_entry} by a curve of one entry, {parametric} by a parametric one");
        assert_eq!(of_entry < -1.0, is_wrong, "a gamma's black has changed");
        assert_eq!(parametric, 0.0, "a parametric curve's black has changed");
    }
    let profile = ColorProfile::new_pro_photo_rgb();
    let of_profile = black(profile.red_trc.as_ref().unwrap());
    let srgb = ColorProfile::new_srgb();
    let transform =
        profile.create_transform_f32(Layout::Rgb, &srgb, Layout::Rgb, TransformOptions::default()).unwrap();
    let mut converted = [9.0_f32; 3];
    transform.transform(&[0.0; 3], &mut converted).unwrap();
    println!("ProPhoto's black is {of_profile} by its curve, {converted:?} by a transform to sRGB");
    assert!(of_profile < -1.0, "ProPhoto's black has changed");
    assert_eq!(converted, [0.0; 3], "the transform's black has changed");
}
RUST
cargo run --quiet
