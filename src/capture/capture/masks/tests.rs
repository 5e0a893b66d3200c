use super::*;

fn entries(paths: &[&str]) -> Vec<Entry> {
    let entry = |path: &&str| Entry::new(PhotoPath::new(path), path.into());
    paths.iter().map(entry).collect()
}

/// The mask files of each photograph, with `!` for those that hide white; the remaining pictures;
/// and the warnings.
fn read(
    folder: &str,
    photographs: &[&str],
    masks: &[&str],
) -> (Vec<String>, Vec<String>, Vec<String>) {
    let inside = |path: &&str| PhotoPath::new(path).inside(folder).to_string();
    let all: Vec<String> =
        photographs.iter().map(inside).chain(masks.iter().map(ToString::to_string)).collect();
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    let mut pictures = entries(&all);
    let found = take(&mut pictures, &[]);
    let mut warnings = Vec::new();
    let photographs = entries(photographs);
    let masks = found.of(&photographs, folder, &mut warnings);
    let describe = |entry: &Entry| {
        let own = masks.of(&entry.path).into_iter();
        let own: Vec<String> = own
            .map(|(mask, picture)| {
                format!("{}{}", mask.path, if picture.white_hides { "!" } else { "" })
            })
            .collect();
        own.join(" ")
    };
    (
        photographs.iter().map(describe).collect(),
        pictures.iter().map(|entry| entry.path.to_string()).collect(),
        warnings.into_iter().map(|warning| warning.message).collect(),
    )
}

#[test]
fn masks_are_found_under_the_names_of_all_programs() {
    let photographs = ["a.jpg", "b.jpg"];
    for masks in [
        ["masks/a.png", "masks/b.png"],
        ["mask/A.png", "mask/b.PNG"],
        ["masks/a.jpg.png", "masks/b.jpg.png"],
        ["images/masks/a.jpg", "images/masks/b.jpg"],
        ["masks/images/a.jpg.png", "masks/images/b.png"],
        ["masks/a_mask.png", "masks/b_mask.png"],
        ["images/a_mask.png", "images/b_mask.jpg"],
        ["images/a.jpg.png", "images/b.jpg.png"],
        ["masks_4/a.png", "masks_4/b.png"],
    ] {
        let (found, _, warnings) = read("images", &photographs, &masks);
        assert_eq!(found, masks, "{masks:?}");
        assert!(warnings.is_empty(), "{warnings:?}");
    }
}

#[test]
fn white_hides_in_the_masks_of_instant_ngp() {
    let masks = ["images/dynamic_mask_a.png"];
    let (found, left, _) = read("images", &["a.jpg", "b.jpg"], &masks);
    assert_eq!(found, ["images/dynamic_mask_a.png!", ""]);
    assert_eq!(left, ["images/a.jpg", "images/b.jpg"], "a mask is no photograph");
}

#[test]
fn masks_are_matched_by_the_folders_of_their_photographs() {
    let photographs = ["cam0/1.jpg", "cam1/1.jpg"];
    let (found, _, _) = read("images", &photographs, &["masks/cam0/1.png", "masks/cam1/1.png"]);
    assert_eq!(found, ["masks/cam0/1.png", "masks/cam1/1.png"]);
    let (found, _, _) = read("", &photographs, &["cam0/masks/1.png", "cam1/masks/1.png"]);
    assert_eq!(found, ["cam0/masks/1.png", "cam1/masks/1.png"]);
}

#[test]
fn a_mask_without_a_photograph_is_reported() {
    let (found, _, warnings) = read("images", &["a.jpg"], &["masks/a.png", "masks/other.png"]);
    assert_eq!(found, ["masks/a.png"]);
    assert_eq!(
        warnings,
        ["1 masks have no photograph of their name, the first is masks/other.png"]
    );
}

#[test]
fn a_photograph_whose_name_ends_like_a_masks_is_a_photograph() {
    let photographs = ["clay_mask.jpg", "wood_mask.jpg"];
    let (found, left, warnings) = read("", &photographs, &[]);
    assert_eq!((found, left.len(), warnings.len()), (vec![String::new(); 2], 2, 0));
}
