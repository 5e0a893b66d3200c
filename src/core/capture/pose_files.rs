//! Which files of a capture give its poses.

use std::path::PathBuf;

use super::entries::Entry;
use super::layout::GivenPosesFile;
use super::photograph::CaptureWarning;
use crate::photo_path::{PhotoPath, find_each};
use crate::poses::model::SparseModel;

/// Folders in which COLMAP models are looked for, themselves or one for each model; "" is the
/// capture, in which only a model of its own is. `sparse_gt/` is not among them: poses are measured
/// against it, it gives none.
const MODELS: [&str; 4] = ["sparse", "colmap/sparse", "dense/sparse", ""];

/// Poses and their files, seen from the folder `base`, in the order of preference.
pub(super) fn find(
    entries: &[Entry],
    base: &str,
    photographs: &[Entry],
    warnings: &mut Vec<CaptureWarning>,
) -> Option<(GivenPosesFile, Vec<Entry>)> {
    let mut models: Vec<Model> = MODELS
        .iter()
        .flat_map(|folder| models_in(entries, base, folder))
        .collect();
    if models.len() > 1 {
        let largest = largest(&models, photographs, warnings);
        models.swap(0, largest);
    }
    if let Some(model) = models.into_iter().next() {
        return Some((GivenPosesFile::ColmapModel(model.folder), model.files));
    }
    let at = |name: &str| {
        let path = PhotoPath::new(name).inside(base);
        let mut all = entries.iter();
        all.find(|e| e.path.as_str().eq_ignore_ascii_case(path.as_str()))
            .cloned()
    };
    let splits = [
        "transforms_train.json",
        "transforms_val.json",
        "transforms_test.json",
    ];
    for names in [&["transforms.json"][..], &splits[..]] {
        let found: Vec<Entry> = names.iter().filter_map(|name| at(name)).collect();
        if let Some(first) = found.first() {
            return Some((GivenPosesFile::Transforms(first.file.clone()), found));
        }
    }
    let bounds = at("poses_bounds.npy")?;
    Some((
        GivenPosesFile::PosesBounds(bounds.file.clone()),
        vec![bounds],
    ))
}

/// A COLMAP model of the capture.
struct Model {
    /// The folder's path inside the capture.
    path: String,
    /// Where that lies.
    folder: PathBuf,
    files: Vec<Entry>,
}

/// The models in a folder, binary ones before those of text. One without points is one too: they
/// can be triangulated.
fn models_in(entries: &[Entry], base: &str, folder: &str) -> Vec<Model> {
    let mut models: Vec<Model> = Vec::new();
    for extension in ["bin", "txt"] {
        let is_part = |e: &Entry, part: &str| {
            e.path
                .name()
                .eq_ignore_ascii_case(&format!("{part}.{extension}"))
        };
        for cameras in entries.iter().filter(|e| is_part(e, "cameras")) {
            let own = cameras.path.folder();
            let Some(path) = cameras.path.below(base) else {
                continue;
            };
            let (parent, _) = path.folder().rsplit_once('/').unwrap_or_default();
            let is_inside = !folder.is_empty() && parent.eq_ignore_ascii_case(folder);
            if !(is_inside || path.folder().eq_ignore_ascii_case(folder))
                || models.iter().any(|model| model.path == own)
            {
                continue;
            }
            let part = |name: &str| {
                let mut all = entries.iter();
                all.find(|e| e.path.folder() == own && is_part(e, name))
            };
            let Some(images) = part("images") else {
                continue;
            };
            let files = [Some(cameras), Some(images), part("points3d")];
            let lies_in = cameras.file.parent();
            models.push(Model {
                path: own.to_owned(),
                folder: lies_in.map(ToOwned::to_owned).unwrap_or_default(),
                files: files.into_iter().flatten().cloned().collect(),
            });
        }
    }
    models
}

/// The model with the poses of most photographs; of equal ones the first.
fn largest(models: &[Model], photographs: &[Entry], warnings: &mut Vec<CaptureWarning>) -> usize {
    let photographs: Vec<PhotoPath> = photographs.iter().map(|e| e.path.clone()).collect();
    let posed = |model: &Model| {
        let (read, _) = SparseModel::read_usable(&model.folder).ok()?;
        let names = read.images.iter().map(|image| PhotoPath::new(&image.name));
        let found = find_each(&names.collect::<Vec<_>>(), &photographs).ok()?;
        Some(found.iter().flatten().count())
    };
    let counts: Vec<Option<usize>> = models.iter().map(posed).collect();
    let most = counts.iter().max().copied().flatten();
    let first = counts.iter().position(|count| *count == most).unwrap_or(0);
    let name = |model: &Model| match &*model.path {
        "" => "that beside the photographs".to_owned(),
        path => path.to_owned(),
    };
    let told = |(model, count): (&Model, &Option<usize>)| match count {
        Some(count) => format!("{} {count}", name(model)),
        None => format!("{} cannot be read", name(model)),
    };
    let all: Vec<String> = models.iter().zip(&counts).map(told).collect();
    let message = format!(
        "of {} COLMAP models {} is taken; photographs with a pose: {}",
        models.len(),
        name(&models[first]),
        all.join(", ")
    );
    warnings.push(CaptureWarning::new("models", message));
    first
}
