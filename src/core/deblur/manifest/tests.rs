use super::*;

#[test]
fn the_default_network_is_built_in_and_is_the_file_that_the_manifest_names() {
    let manifest = Manifest::embedded();
    let model = manifest.resolve("default", &[]).expect("embedded");
    let entry = manifest
        .models
        .iter()
        .find(|entry| entry.default)
        .expect("a default");
    assert_eq!(Some(&model.sha256), entry.sha256.as_ref());
    assert_eq!(entry.bytes, Some(model.bytes.len() as u64));
    assert_eq!((model.channels, entry.role), (Some(6), Role::Guided));
    let larger = manifest.default_on_cuda().expect("one for GPUs");
    assert!(
        larger.built_in() && larger.role == Role::Guided && larger.bytes > entry.bytes,
        "{larger:?}"
    );
    assert_eq!(
        manifest
            .resolve(&larger.id, &[])
            .expect("embedded")
            .bytes
            .len() as u64,
        larger.bytes.unwrap_or(0)
    );
}

#[test]
fn ids_are_unique_and_channels_agree_with_role_and_order() {
    let manifest = Manifest::embedded();
    for (index, entry) in manifest.models.iter().enumerate() {
        assert!(
            manifest.models[..index]
                .iter()
                .all(|other| other.id != entry.id),
            "{}",
            entry.id
        );
        assert_eq!(entry.channels, 3 * entry.order.len() as u32, "{}", entry.id);
        assert_eq!(
            entry.role == Role::Guided,
            entry.channels == 6,
            "{}",
            entry.id
        );
        assert!(
            !entry.licence.is_empty() && entry.order[0] == "blurry",
            "{}",
            entry.id
        );
    }
    assert_eq!(
        manifest.models.iter().filter(|entry| entry.default).count(),
        1
    );
    assert_eq!(
        manifest
            .models
            .iter()
            .filter(|entry| entry.default_on_cuda)
            .count(),
        1
    );
}

#[test]
fn a_damaged_file_is_refused_by_its_checksum() {
    let directory = tempfile::tempdir().expect("temporary directory");
    std::fs::write(
        directory.path().join("NAFNet-GoPro-width32.onnx"),
        "damaged",
    )
    .expect("write");
    let refused = Manifest::embedded()
        .resolve("nafnet-gopro-w32", &[directory.path().to_path_buf()])
        .expect_err("not the file");
    assert!(
        matches!(refused, DeblurError::ModelChecksum { .. }),
        "{refused}"
    );
}

#[test]
fn a_network_whose_file_is_missing_says_where_to_get_it() {
    let missing = Manifest::embedded().resolve("nafnet-gopro-w32", &["data/models".into()]);
    let text = missing.expect_err("not here").to_string();
    assert!(
        text.contains("https://") && text.contains("data/models"),
        "{text}"
    );
    let by_hand = Manifest::embedded()
        .resolve("deepdeblurrf-official", &[])
        .expect_err("no file");
    assert!(by_hand.to_string().contains("fled models add"), "{by_hand}");
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let unknown = Manifest::embedded()
        .resolve("nafnet", &[])
        .expect_err("unknown");
    assert!(unknown.to_string().contains("small-u2w16"), "{unknown}");
}

fn overlaid(entries: &serde_json::Value) -> (tempfile::TempDir, Result<Manifest, DeblurError>) {
    let directory = tempfile::tempdir().expect("temporary directory");
    let text = serde_json::json!({ "models": entries }).to_string();
    std::fs::write(directory.path().join(OVERLAY), text).expect("write");
    let known = Manifest::known(&[directory.path().to_path_buf()]);
    (directory, known)
}

fn entry(id: &str, file: &str, default: bool) -> serde_json::Value {
    serde_json::json!({
        "id": id, "role": "single", "file": file, "sha256": null, "bytes": null, "licence": "MIT", "channels": 3,
        "order": ["blurry"], "multiple": 8, "minimum_side": 16, "tile": 512, "range": [-1.0, 2.0],
        "input": null, "output": null, "default": default,
    })
}

#[test]
fn the_users_entries_are_added_or_take_the_place_of_ours() {
    let entries = serde_json::json!([
        entry("mine", "mine.onnx", true),
        entry("nafnet-gopro-w32", "n.onnx", false)
    ]);
    let (_directory, known) = overlaid(&entries);
    let known = known.expect("readable");
    assert_eq!(known.models.len(), Manifest::embedded().models.len() + 1);
    assert_eq!(
        known.find("default").map(|entry| entry.id.as_str()),
        Some("mine")
    );
    assert_eq!(
        known.default_on_cuda(),
        None,
        "the user's own default is it on a GPU, too"
    );
    let mut for_cuda = entry("mine", "mine.onnx", false);
    for_cuda["default_on_cuda"] = true.into();
    let (_directory, on_cuda) = overlaid(&serde_json::json!([for_cuda]));
    let on_cuda = on_cuda.expect("readable");
    assert_eq!(
        on_cuda.default_on_cuda().map(|entry| entry.id.as_str()),
        Some("mine")
    );
    assert_eq!(
        on_cuda.find("default").map(|entry| entry.id.as_str()),
        Some("small-u2w16")
    );
    let replaced = known
        .find("nafnet-gopro-w32")
        .and_then(|entry| entry.file.clone());
    assert_eq!(replaced.as_deref(), Some("n.onnx"));
    let written = serde_json::to_string(&known).expect("serialises");
    let again: Manifest = serde_json::from_str(&written).expect("what is written is read");
    assert_eq!(again.models, known.models);
}

#[test]
fn an_overlay_with_a_fault_is_named_with_the_fault() {
    for (entries, word) in [
        (
            serde_json::json!([entry("identity", "a.onnx", false)]),
            "identity",
        ),
        (
            serde_json::json!([entry("a", "../a.onnx", false)]),
            "without a folder",
        ),
        (serde_json::json!([{ "id": "a" }]), "missing field"),
    ] {
        let (directory, known) = overlaid(&entries);
        let text = known.expect_err("refused").to_string();
        assert!(
            text.contains(word) && text.contains(&directory.path().display().to_string()),
            "{text}"
        );
    }
    assert_eq!(
        Manifest::overlay(Path::new("/nowhere"))
            .expect("none is no fault")
            .models,
        []
    );
}

#[test]
fn a_stray_file_does_not_take_the_place_of_what_is_built_in() {
    let directory = tempfile::tempdir().expect("temporary directory");
    std::fs::write(directory.path().join("small-u2w16.onnx"), "stray").expect("write");
    let folders = [directory.path().to_path_buf()];
    let model = Manifest::known(&folders)
        .expect("readable")
        .resolve("default", &folders);
    assert!(model.expect("built in").golden.is_some());
}

#[test]
fn a_known_file_given_by_path_keeps_its_identity() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/small-u2w16.onnx");
    let model = Manifest::embedded()
        .resolve(&path.display().to_string(), &[])
        .expect("present");
    assert_eq!(model.id, "small-u2w16");
}

#[test]
fn the_names_of_an_entry_reach_the_network_that_is_loaded() {
    let mut two = entry("two", "two.onnx", false);
    (two["input"], two["output"]) = ("view".into(), "restored".into());
    let (directory, known) = overlaid(&serde_json::json!([two]));
    std::fs::write(directory.path().join("two.onnx"), "a network").expect("write");
    let model = known
        .expect("read")
        .resolve("two", &[directory.path().to_path_buf()])
        .expect("there");
    for model in [&model, &model.without_bytes()] {
        assert_eq!(
            (model.input.as_deref(), model.output.as_deref()),
            (Some("view"), Some("restored")),
            "{model:?}"
        );
    }
}
