use glam::{DQuat, DVec3};

use super::super::fixtures::scattered;
use super::container::{BINARY_CHUNK, FLOAT, JSON_CHUNK, MAGIC};
use super::*;
use crate::camera::normalisation::Normalisation;
use crate::image::linear_to_srgb;

/// The file's JSON and its buffer.
fn parsed(bytes: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(bytes[at..][..4].try_into().expect("four")) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&MAGIC[..], 2, bytes.len()));
    let text = word(12);
    assert_eq!((&bytes[16..20], text % 4), (&JSON_CHUNK[..], 0));
    let buffer = &bytes[20 + text..];
    assert_eq!((&buffer[4..8], word(20 + text) + 8), (&BINARY_CHUNK[..], buffer.len()));
    (serde_json::from_slice(&bytes[20..20 + text]).expect("JSON"), &buffer[8..])
}

/// The numbers of an attribute, row after row.
fn numbers(document: &Value, buffer: &[u8], semantic: &str) -> Vec<f32> {
    let number = |value: &Value| value.as_u64().expect("a number") as usize;
    let attributes = &document["meshes"][0]["primitives"][0]["attributes"];
    let accessor = &document["accessors"][number(&attributes[semantic])];
    let view = &document["bufferViews"][number(&accessor["bufferView"])];
    let (at, length) = (number(&view["byteOffset"]), number(&view["byteLength"]));
    let width = match accessor["type"].as_str() {
        Some("SCALAR") => 1,
        Some(vector) => vector[3..].parse().expect("a width"),
        None => panic!("no type"),
    };
    let size = if accessor["componentType"] == FLOAT { 4 } else { 2 };
    assert_eq!((at % 4, length), (0, number(&accessor["count"]) * width * size));
    let numbers = buffer[at..at + length].chunks_exact(size);
    numbers
        .map(|bytes| match bytes {
            &[a, b] => f32::from(u16::from_le_bytes([a, b])) / 65_535.0,
            bytes => f32::from_le_bytes(bytes.try_into().expect("four")),
        })
        .collect()
}

fn written(gaussians: &Gaussians, normalisation: Normalisation) -> Vec<u8> {
    let mut bytes = Vec::new();
    let scene = Scene { gaussians: gaussians.clone(), normalisation };
    write_to(&scene, Placement::default(), &mut bytes).expect("written");
    bytes
}

#[test]
fn every_number_is_found_again_with_y_up() {
    for degree in 0..=3 {
        let scene = scattered(50, 8.0, degree);
        let bytes = written(&scene, Normalisation::default());
        let (document, buffer) = parsed(&bytes);
        assert_eq!(buffer.len() as u64, bytes_of(50, degree));
        assert_eq!(document["buffers"][0]["byteLength"], buffer.len());
        let of = |name: &str| numbers(&document, buffer, name);
        let own = |name: &str| of(&format!("KHR_gaussian_splatting:{name}"));
        let turned = scene.turned_y_up();
        assert_eq!(of("POSITION"), turned.means.as_flattened());
        let accessor = &document["accessors"][0];
        for (axis, pick) in (0..3).flat_map(|axis| [(axis, "min"), (axis, "max")]) {
            let values = turned.means.iter().map(|mean| mean[axis]);
            let end = if pick == "min" { values.reduce(f32::min) } else { values.reduce(f32::max) };
            assert_eq!(accessor[pick][axis].as_f64(), end.map(f64::from));
        }
        let (rotations, scales, opacities) = (own("ROTATION"), own("SCALE"), own("OPACITY"));
        let sh: Vec<_> = (0..=degree)
            .flat_map(|l| (0..=2 * l).map(move |n| format!("SH_DEGREE_{l}_COEF_{n}")))
            .map(|name| own(&name))
            .collect();
        let colours = of("COLOR_0");
        for index in 0..50 {
            let [w, x, y, z] = turned.rotation(index).map(|q| q as f32);
            assert_eq!(rotations[4 * index..][..4], [x, y, z, w]);
            assert_eq!(scales[3 * index..][..3], turned.log_scales[index].map(f32::exp));
            assert_eq!(opacities[index], turned.opacity(index) as f32);
            let row: Vec<f32> = sh.iter().flat_map(|one| one[3 * index..][..3].to_vec()).collect();
            assert_eq!(row, turned.sh[row.len() * index..][..row.len()]);
            for channel in 0..3 {
                let shown = linear_to_srgb(colours[4 * index + channel]);
                let base = (0.5 + Y00 * row[channel]).clamp(0.0, 1.0);
                assert!((shown - base).abs() < 0.001, "{shown} {base}");
            }
        }
    }
}

#[test]
fn the_node_carries_the_offset_that_positions_lack() {
    let scene = scattered(4, 1.0, 0);
    let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
    for left_out in [true, false] {
        let by = Normalisation { offset, scale: 0.0625, left_out };
        let bytes = written(&scene, by);
        let (document, buffer) = parsed(&bytes);
        let translation = &document["nodes"][0]["translation"];
        let x = f64::from(numbers(&document, buffer, "POSITION")[0]);
        let world = x + translation[0].as_f64().unwrap_or_default();
        assert!((world - by.point_in_world(scene.means[0].map(f64::from).into()).x).abs() < 0.04);
        let expected = json!([512_352.0, 5_412_352.0, -64.0]);
        assert_eq!(*translation, if left_out { expected } else { Value::Null });
    }
}

#[test]
fn the_node_carries_a_scale_that_multiplies_the_offset_too() {
    let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
    let normalisation = Normalisation { offset, scale: 0.0625, left_out: true };
    let scene = Scene { gaussians: scattered(4, 1.0, 0), normalisation };
    let [one, large] = [1.0, 2.5].map(|scale| {
        let mut bytes = Vec::new();
        write_to(&scene, Placement { scale, ..Placement::default() }, &mut bytes).expect("written");
        bytes
    });
    let ((one, own), (large, placed)) = (parsed(&one), parsed(&large));
    assert!(own == placed, "the coordinates stay");
    assert_eq!(one["nodes"][0]["scale"], Value::Null);
    assert_eq!(large["nodes"][0]["scale"], json!([2.5, 2.5, 2.5]));
    assert_eq!(large["nodes"][0]["translation"], json!([1_280_880.0, 13_530_880.0, -160.0]));
}

#[test]
fn the_node_stands_the_scene_upright() {
    let offset = DVec3::new(512_352.0, 5_412_352.0, 64.0);
    let askew = DVec3::new(0.2, -0.9, 0.4).normalize();
    for (up, left_out) in [(askew, false), (askew, true), (DVec3::Z, true), (DVec3::Y, false)] {
        let normalisation = Normalisation { offset, scale: 0.0625, left_out };
        let scene = Scene { gaussians: scattered(4, 1.0, 0), normalisation };
        let mut bytes = Vec::new();
        write_to(&scene, Placement { up, ..Placement::default() }, &mut bytes).expect("written");
        let (document, buffer) = parsed(&bytes);
        let node = &document["nodes"][0];
        let rotation: [f64; 4] = serde_json::from_value(node["rotation"].clone()).expect("four");
        let rotation = DQuat::from_array(rotation);
        let translation: [f64; 3] =
            serde_json::from_value(node["translation"].clone()).unwrap_or_default();
        let placed = |at: DVec3| rotation * DVec3::new(at.x, -at.y, -at.z);
        assert!((placed(up) - DVec3::Y).length() < 1e-9, "{up}");
        // The centre of a Gaussian in the file, placed by the node, is that of the world, turned.
        let own = numbers(&document, buffer, "POSITION");
        let own = DVec3::new(own[0].into(), own[1].into(), own[2].into());
        let shown = rotation * own + DVec3::from_array(translation);
        let world = normalisation.point_in_world(scene.gaussians.means[0].map(f64::from).into());
        assert!((shown - placed(world)).length() < 0.5, "{shown} {world}");
        if up == DVec3::Z {
            // East is x and north is away from the viewer.
            assert!((shown - DVec3::new(world.x, world.z, -world.y)).length() < 0.5);
        }
    }
}

#[test]
fn non_finite_gaussians_are_left_out_and_an_empty_scene_is_refused() {
    let mut scene = scattered(3, 1.0, 1);
    scene.means[1][2] = f32::NAN;
    let bytes = written(&scene, Normalisation::default());
    assert_eq!(parsed(&bytes).0["accessors"][0]["count"], 2);
    let empty = Scene { gaussians: scene.select(&[1]), normalisation: Normalisation::default() };
    let error = write_to(&empty, Placement::default(), &mut Vec::new()).expect_err("empty");
    assert!(error.to_string().contains("without Gaussians"), "{error}");
}
