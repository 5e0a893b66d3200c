use super::*;

const SCENES: [Export; 7] = [
    Export::Ply,
    Export::CompressedScene,
    Export::Gltf,
    Export::Usd,
    Export::SpzVersion3,
    Export::Spz,
    Export::Sog,
];

const MESHES: [Export; 2] = [Export::MeshPly, Export::MeshGltf];

fn crop(text: &str) -> Trim {
    Trim { crop: Some(text.parse().expect("a crop")), sh_degree: None, ..Trim::default() }
}

/// The scene in a trimmed export as PLY.
fn read(run: &RunFolder, trim: Trim) -> Scene {
    let path = run.root().join("trimmed.ply");
    fs::write(&path, trimmed(Export::Ply, run, None, trim)).expect("written");
    ply::read(&path).expect("a scene")
}

#[test]
fn a_scene_without_a_trim_is_the_runs_own_file() {
    let (_folder, run) = result();
    assert!(written(Export::Ply, &run, None) == fs::read(run.scene()).expect("read"));
    let prepared = Export::Ply.prepare(&run, None, Trim::default()).expect("there");
    assert_eq!(prepared.bytes(), fs::metadata(run.scene()).expect("there").len());
}

#[test]
fn a_crop_keeps_the_gaussians_inside_it_in_every_scene() {
    let (_folder, run) = result();
    let kept = |trim: Trim| read(&run, trim).gaussians.means;
    assert_eq!(kept(crop("sphere:0,0,0,1")), [[0.0; 3]]);
    assert_eq!(kept(crop("box:1,2,3,0.1,0.1,0.1")), [[1.0, 2.0, 3.0]]);
    assert_eq!(kept(crop("box:5,5,5,9,9,9")), [[1.0, 2.0, 3.0], [9.0; 3]]);
    for export in SCENES {
        let all = Trim { crop: crop("sphere:0,0,0,99").crop, sh_degree: None, ..Trim::default() };
        let [all, one] = [all, crop("sphere:0,0,0,1")]
            .map(|trim| export.prepare(&run, None, trim).expect("there").bytes());
        assert!(one < all, "{}", export.name());
        assert!(!trimmed(export, &run, None, crop("sphere:0,0,0,1")).is_empty());
    }
}

#[test]
fn a_crop_is_in_the_world_of_the_poses() {
    let (_folder, run) = result();
    let offset = DVec3::new(512_352.0, -5_412_352.0, 64.0);
    let gaussians = ply::read(&run.scene()).expect("read").gaussians;
    let by = Normalisation { offset, scale: 0.0625, left_out: true };
    ply::write(&gaussians, &by, &run.scene()).expect("written");
    // The second one is trained at 1, 2, 3.
    let left = read(&run, crop("box:512368,-5412320,112,1,1,1"));
    assert_eq!((left.gaussians.means, left.normalisation), (vec![[1.0, 2.0, 3.0]], by));
    let elsewhere = Export::Ply.prepare(&run, None, crop("sphere:1,2,3,1")).expect_err("nothing");
    let said = elsewhere.to_string();
    assert!(said.ends_with("the scene is at 512368.000,-5412320.000,112.000"), "{said}");
}

#[test]
fn what_has_a_node_stands_upright_as_its_cameras_do() {
    let (_folder, run) = result();
    let up = DVec3::new(0.5, -0.8, 0.3).normalize();
    let k = Intrinsics { width: 8, height: 6, fx: 9.5, fy: 9.25, cx: 4.0, cy: 3.125 };
    let camera = |eye: [f64; 3]| {
        NamedCamera::new("a", &Camera::look_at(k, eye.into(), DVec3::ONE, -up), Split::Train)
    };
    let cameras = [camera([3.0, 0.0, -3.0]), camera([-3.0, 0.0, -1.0]), camera([0.0, -2.0, 3.0])];
    fs::write(run.cameras(), serde_json::to_vec(&cameras).expect("JSON")).expect("written");
    for export in [Export::Gltf, Export::MeshGltf] {
        let placement = match export.prepare(&run, None, Trim::default()).expect("there").0 {
            Content::Scene { placement, .. } | Content::Unmeshed { placement, .. } => placement,
            other => panic!("{other:?}"),
        };
        assert!(placement.up.angle_between(up) < 0.02, "{} {}", export.name(), placement.up);
    }
    fs::remove_file(run.cameras()).expect("removed");
    let error = Export::Gltf.prepare(&run, None, Trim::default()).expect_err("no cameras");
    assert!(error.to_string().contains("cameras.json"), "{error}");
    assert!(!written(Export::Spz, &run, None).is_empty(), "it has no node");
}

#[test]
fn harmonics_are_padded_and_cut() {
    let (_folder, run) = result();
    let own = ply::read(&run.scene()).expect("read").gaussians;
    for degree in 0..=MOST_SH_DEGREE {
        let trim = Trim { crop: None, sh_degree: Some(degree), ..Trim::default() };
        let bytes = Export::Ply.prepare(&run, None, trim).expect("there").bytes();
        assert_eq!(bytes, 3 * [68, 104, 164, 248][degree as usize]);
        assert_eq!(read(&run, trim).gaussians, own.with_sh_degree(degree));
        for export in SCENES {
            assert!(!trimmed(export, &run, None, trim).is_empty());
        }
    }
    ply::write(&own.with_sh_degree(2), &Normalisation::default(), &run.scene()).expect("written");
    let cut = read(&run, Trim { crop: None, sh_degree: Some(0), ..Trim::default() });
    assert_eq!(cut.gaussians, own);
}

#[test]
fn a_scale_multiplies_all_lengths_after_the_crop() {
    let (_folder, run) = result();
    let scaled = Trim { scale: Some(2.5), ..crop("box:1,2,3,0.1,0.1,0.1") };
    let Scene { gaussians, normalisation } = read(&run, scaled);
    let place = normalisation.point_in_world(DVec3::from(gaussians.means[0].map(f64::from)));
    assert!(gaussians.len() == 1 && place.abs_diff_eq(DVec3::new(2.5, 5.0, 7.5), 1e-6), "{place}");
    let size = f64::from(gaussians.log_scales[0][1]).exp() / normalisation.scale;
    assert!((size - 2.5 * (-2f64).exp()).abs() < 1e-6, "{size}");
    let file = fs::read(run.root().join("trimmed.ply")).expect("read");
    let row: Vec<f32> = file[file.len() - 68..]
        .as_chunks()
        .0
        .iter()
        .map(|four| f32::from_le_bytes(*four))
        .collect();
    assert_eq!(row[..3], [2.5, 5.0, 7.5], "what other programs read");
    for export in SCENES {
        let [one, large] = [None, Some(2.5)]
            .map(|scale| trimmed(export, &run, None, Trim { scale, ..Trim::default() }));
        assert!(one != large, "{}", export.name());
    }
}

#[test]
fn a_scale_that_is_none_says_what_is_wrong() {
    assert_eq!(Trim::scale(0.25), Ok(0.25));
    for wrong in [0.0, -2.0, 2e6, f64::NAN, f64::INFINITY] {
        let fault = Trim::scale(wrong).expect_err("no scale");
        assert_eq!(fault, format!("must be from 0.000001 to 1000000, not {wrong}"));
    }
    let (_folder, run) = result();
    let scaled = Trim { scale: Some(2.5), ..Trim::default() };
    for export in Export::ALL {
        let fault = export.prepare(&run, None, scaled).err().map(|error| error.to_string());
        assert_eq!(fault.is_none(), export.has_scene(), "{fault:?}");
        assert!(fault.is_none_or(|fault| fault.contains("crop, scale and degree")));
    }
}

#[test]
fn what_cannot_be_trimmed_says_why() {
    let (_folder, run) = result();
    let nothing = crop("box:-5,0,0,1,1,1");
    for export in Export::ALL {
        let error = export.prepare(&run, None, nothing).expect_err("nothing is left");
        let said = error.to_string();
        let expected = if SCENES.contains(&export) || MESHES.contains(&export) {
            "no Gaussian's centre is inside the crop"
        } else {
            "holds no scene"
        };
        assert!(error.is_of_wish() && !error.is_missing() && said.contains(expected), "{said}");
    }
}

#[test]
fn only_a_mesh_has_triangles_and_only_a_scene_has_harmonics() {
    let (_folder, run) = result();
    let mesh = Detail { triangles: Some(500), voxel: None };
    let fine = Trim { mesh, ..Trim::default() };
    let degree = Trim { sh_degree: Some(1), ..Trim::default() };
    for export in Export::ALL {
        let is_mesh = MESHES.contains(&export);
        let refused = |trim| export.prepare(&run, None, trim).err().map(|error| error.to_string());
        let fault = refused(fine);
        assert_eq!(fault.is_none(), is_mesh, "{fault:?}");
        assert!(fault.is_none_or(|fault| fault.contains("is not a mesh")));
        assert_eq!(refused(degree).is_none(), SCENES.contains(&export), "{}", export.name());
    }
}

#[test]
fn a_scene_without_a_surface_has_no_mesh() {
    let (_folder, run) = result();
    for export in MESHES {
        let prepared = export.prepare(&run, None, Trim::default()).expect("there");
        assert!(prepared.bytes() > 1_000_000 && prepared.facts().is_none());
        let error = prepared.meshed().expect_err("three Gaussians");
        assert!(error.to_string().contains("nothing to mesh"), "{error}");
        assert!(!error.is_of_wish() && !error.is_missing());
    }
}
