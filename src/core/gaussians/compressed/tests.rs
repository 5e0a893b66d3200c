use super::super::fixtures::{differences, scattered};
use super::*;
use crate::camera::normalisation::Normalisation;

/// The scene's file: its header, and the rest.
fn written(scene: &Gaussians) -> (String, Vec<u8>) {
    let mut bytes = Vec::new();
    let scene = Scene { gaussians: scene.clone(), normalisation: Normalisation::default() };
    write_to(&scene, &mut bytes).expect("written");
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|w| w == end);
    let body = bytes.split_off(at.expect("a header") + end.len());
    (String::from_utf8(bytes).expect("text"), body)
}

/// Reads the packed body as PlayCanvas' tools do, with these numbers of Gaussians and harmonics.
fn read(body: &[u8], count: usize, coefficients: usize) -> Gaussians {
    let chunks = count.div_ceil(CHUNK);
    let word = |at: usize| u32::from_le_bytes(body[4 * at..][..4].try_into().expect("four"));
    let lerp = |chunk: usize, of: usize, share: [f32; 3]| -> [f32; 3] {
        std::array::from_fn(|i| {
            let end = |which: usize| f32::from_bits(word(18 * chunk + 6 * of + 3 * which + i));
            end(0) * (1.0 - share[i]) + end(1) * share[i]
        })
    };
    let part = |word: u32, shift: u32, bits: u32| {
        (word >> shift & ((1 << bits) - 1)) as f32 / ((1 << bits) - 1) as f32
    };
    let thirds = |word: u32| [part(word, 21, 11), part(word, 11, 10), part(word, 0, 11)];
    let mut scene =
        Gaussians { sh_degree: coefficients.isqrt() as u32 - 1, ..Gaussians::default() };
    let higher = 3 * (coefficients - 1);
    for index in 0..count {
        let (chunk, at) = (index / CHUNK, 18 * chunks + 4 * index);
        scene.means.push(lerp(chunk, 0, thirds(word(at))));
        scene.log_scales.push(lerp(chunk, 1, thirds(word(at + 2))));
        let rotation = word(at + 1);
        let others = [20, 10, 0].map(|shift| (part(rotation, shift, 10) - 0.5) * 2_f32.sqrt());
        let squares: f32 = others.iter().map(|q| q * q).sum();
        let mut quat = others.to_vec();
        quat.insert((rotation >> 30) as usize, (1.0 - squares).max(0.0).sqrt());
        scene.quats.push(quat.try_into().expect("four"));
        let packed = word(at + 3);
        let rgb = [24, 16, 8].map(|shift| part(packed, shift, 8));
        let base = lerp(chunk, 2, rgb).map(|value| (value - 0.5) / Y00);
        let opacity = part(packed, 0, 8);
        scene.opacity_logits.push((opacity / (1.0 - opacity)).ln());
        let bytes = &body[4 * (18 * chunks + 4 * count) + higher * index..][..higher];
        let value = |channel: usize, n: usize| {
            let byte = bytes[channel * (coefficients - 1) + n];
            ((f32::from(byte) + 0.5) / 256.0 - 0.5) * 8.0
        };
        scene.sh.extend(base);
        let rest = (0..coefficients - 1).flat_map(|n| [0, 1, 2].map(|c| value(c, n)));
        scene.sh.extend(rest);
    }
    scene
}

#[test]
fn a_round_trip_differs_by_at_most_half_a_step() {
    for degree in 0..=3 {
        let scene = scattered(1000, 8.0, degree);
        let (header, body) = written(&scene);
        assert!(header.contains("element chunk 4\n") && header.contains("element vertex 1000\n"));
        assert_eq!(header.contains("element sh 1000\n"), degree > 0);
        assert_eq!(body.len() as u64, bytes_of(1000, degree));
        let expected = scene.select(&along_curve(&scene));
        let back = read(&body, 1000, scene.coefficients());
        let found = differences(&expected, &back);
        // Half a step of 10 bits for the cube and the scales, of eight bits for the colours; a step
        // of 10 bits for a rotation; half a step of 8.
        let bounds =
            [8.0 / 2046.0, 6.0 / 2046.0, 3.0 * Y00 / 510.0, 1.0 / 510.0, 0.006, 1.0 / 64.0];
        for (found, bound) in found.iter().zip(bounds) {
            assert!(*found <= bound * 1.01, "degree {degree}: {found} > {bound}");
        }
    }
}

#[test]
fn a_distant_gaussian_affects_only_its_own_chunk() {
    let mut scene = scattered(2000, 1.0, 0);
    scene.means[77] = [1e4, -1e4, 1e4];
    let expected = scene.select(&along_curve(&scene));
    let back = read(&written(&scene).1, 2000, 1);
    let is_off = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|i| (a[i] - b[i]).abs() > 1e-3);
    let off = expected.means.iter().zip(&back.means);
    let off = off.filter(|pair| is_off(*pair)).count();
    assert!((1..=CHUNK).contains(&off), "{off} are off");
}

#[test]
fn non_finite_values_are_left_out_and_an_empty_scene_is_written() {
    let mut scene = scattered(10, 1.0, 1);
    scene.means[3][1] = f32::NAN;
    let (header, body) = written(&scene);
    assert!(header.contains("element vertex 9\n"));
    assert_eq!(body.len() as u64, bytes_of(9, 1));
    let (header, body) = written(&Gaussians::default());
    assert!(header.contains("element vertex 0\n") && body.is_empty());
}

#[test]
fn out_of_range_opacities_and_harmonics_stay_finite() {
    let mut scene = scattered(2, 1.0, 1);
    scene.opacity_logits = vec![-60.0, 60.0];
    scene.sh[4] = 1e9;
    scene.sh[5] = -1e9;
    let back = read(&written(&scene).1, 2, 4);
    assert!(back.opacity_logits.iter().all(|logit| logit.is_finite()));
    assert!(back.sh.iter().all(|value| value.abs() <= 5.4));
}
