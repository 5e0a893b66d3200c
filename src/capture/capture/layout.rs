//! Determines the role of each file of a capture.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::image::{Unread, named_like_a_photograph};
use crate::photo_path::{PhotoPath, Tie, find_each};

use super::entries::{Entry, natural};
use super::error::CaptureError;
use super::folders::is_of_a_run;
use super::heads::{self, Recognised};
use super::masks::{self, Masks};
use super::photograph::CaptureWarning;
use super::place::{self, Place};
use super::pose_files::{self, GivenPosesFile, POSE_FILES};
use super::video::is_video;

/// Folders with a meaning; none of them is a wrapper around the capture.
const KNOWN_FOLDERS: [&str; 5] = ["images", "gt", "hl", "sparse", "sparse_gt"];

/// A capture's files by their role.
#[derive(Debug)]
pub(super) struct Layout {
    /// Files that claim to be photographs, in natural order, with paths relative to `folder`.
    pub(super) photographs: Vec<Entry>,
    /// The folder of the photographs; empty for the capture's root.
    folder: String,
    /// Videos and files in unsupported formats beside them: listed, not used.
    pub(super) unused: Vec<Entry>,
    /// Ground truth by photograph; empty if there is none.
    pub(super) ground_truth: HashMap<PhotoPath, Entry>,
    /// Masks by photograph.
    pub(super) masks: Masks,
    /// Poses.
    pub(super) poses: Option<GivenPosesFile>,
    /// The pose files, for the fingerprint.
    pose_files: Vec<Entry>,
    /// The capture itself holds out every n-th photograph.
    pub(super) hold: Option<u32>,
    /// Which pictures are not read, and which poses are.
    pub(super) warnings: Vec<CaptureWarning>,
    /// A digest of where all files are and what their owner calls them, used or not.
    pub(super) files: String,
}

impl Layout {
    /// # Errors
    /// [`CaptureError::NoPhotographs`], [`CaptureError::Scattered`].
    pub(super) fn of(entries: Vec<Entry>) -> Result<Self, CaptureError> {
        let (pictures, others): (Vec<_>, Vec<_>) =
            entries.into_iter().partition(claims_to_be_a_photograph);
        let Beside { pictures, others, foreign_poses, result } = Beside::of(pictures, others);
        let foreign = foreign_poses.iter().map(|(entry, _)| entry);
        let files = digest(pictures.iter().chain(&others).chain(foreign));
        // Files without a role may be anywhere.
        let count = pictures.len();
        let mut entries: Vec<Entry> = pictures.into_iter().chain(others).collect();
        strip_wrappers(&mut entries);
        let mut others = entries.split_off(count);
        let mut pictures = entries;
        for entries in [&mut pictures, &mut others] {
            entries.sort_by(|a, b| {
                natural(a.path.as_str(), b.path.as_str()).then(a.number.cmp(&b.number))
            });
        }
        let hold = others.iter().find_map(|e| hold(e.path.as_str()));
        let unused: Vec<Entry> =
            { others.iter() }.filter(|entry| is_unused(entry)).cloned().collect();
        let named_poses: Vec<&Entry> = others.iter().filter(|e| names_photographs(e)).collect();
        let masks = masks::take(&mut pictures, &named_poses);
        let has_low_and_high = place::part_low_light(&mut pictures);
        let (truth, pictures): (Vec<_>, Vec<_>) = { pictures.into_iter() }
            .partition(|e| e.path.lies_in(&place::TRUTH) || has_low_and_high && place::is_high(e));
        let place = place_of(pictures, &named_poses, &unused).map_err(|error| match error {
            CaptureError::NoPhotographs { seen, video, .. } => {
                CaptureError::NoPhotographs { seen, video, result }
            }
            error => error,
        })?;
        let Place { folder, photographs, others: elsewhere, warning } =
            place.named_by(&pose_files::names(&named_poses));
        let mut warnings = Vec::from_iter(warning);
        let masks = masks.of(&photographs, &folder, &mut warnings);
        let truth = beside_photographs(truth, &photographs, &folder);
        let ground_truth = of_photographs(&truth, &photographs).unwrap_or_else(|tie| {
            let message = format!("ground truth is not used: {tie}");
            warnings.push(CaptureWarning::new("gt_missing", message));
            HashMap::new()
        });
        let found = pose_files::find(&others, &folder, &photographs, &elsewhere, &mut warnings);
        let (poses, pose_files) = found.unzip();
        if poses.is_none() {
            warnings.extend(pose_files::foreign(&foreign_poses));
        }
        Ok(Self {
            ground_truth,
            masks,
            unused: beside(unused, &photographs, &folder),
            photographs,
            folder,
            poses,
            pose_files: pose_files.unwrap_or_default(),
            hold,
            warnings,
            files,
        })
    }

    /// blake3 of the names and contents of everything with a role.
    pub(super) fn fingerprint(&self) -> Result<String, CaptureError> {
        let mut hasher = blake3::Hasher::new();
        let mut truth: Vec<&Entry> = self.ground_truth.values().collect();
        truth.sort_by_key(|entry| entry.path.stem().to_lowercase());
        let photographs = self.photographs.iter().map(|e| (e.path.inside(&self.folder), e));
        let others = { truth.into_iter() }
            .chain(&self.pose_files)
            .chain(self.masks.entries())
            .map(|e| (e.path.clone(), e));
        for (path, entry) in photographs.chain(others) {
            let mut content = blake3::Hasher::new();
            let file = File::open(&entry.file);
            // A dangling link is listed as an unreadable photograph.
            if let Err(error) = file.and_then(|file| content.update_reader(file).map(drop))
                && error.kind() != ErrorKind::NotFound
            {
                return Err(CaptureError::io(&entry.file)(error));
            }
            // The length separates a name from the content that follows it.
            hasher.update(&(path.as_str().len() as u64).to_le_bytes());
            hasher.update(path.as_str().as_bytes());
            hasher.update(content.finalize().as_bytes());
        }
        if let Some(hold) = self.hold {
            hasher.update(format!("{HOLD}{hold}").as_bytes());
        }
        Ok(hasher.finalize().to_hex().to_string())
    }
}

fn digest<'a>(entries: impl Iterator<Item = &'a Entry>) -> String {
    let name = |entry: &Entry| format!("{}\0{}", entry.path, entry.file.display());
    let mut names: Vec<String> = entries.map(name).collect();
    names.sort_unstable();
    blake3::hash(names.join("\0").as_bytes()).to_string()
}

/// Prefix of the file name that sets it, as in the Deblur-NeRF and ExBluRF sets.
const HOLD: &str = "hold=";

/// The hold-out interval that an entry specifies: every n-th photograph, from the first. Below 2
/// nothing is left to train on.
pub(super) fn hold(path: &str) -> Option<u32> {
    let number = path.strip_prefix(HOLD)?.parse().ok()?;
    (number >= 2).then_some(number)
}

/// A capture's files without those of fled results, which may be among them.
struct Beside {
    pictures: Vec<Entry>,
    /// Files with a meaning.
    others: Vec<Entry>,
    /// Poses in unsupported formats, with the programs that write them.
    foreign_poses: Vec<(Entry, &'static str)>,
    /// The folder of one of the results.
    result: Option<String>,
}

impl Beside {
    fn of(pictures: Vec<Entry>, others: Vec<Entry>) -> Self {
        let recognised: Vec<(Entry, Option<Recognised>)> = { others.into_iter() }
            .map(|entry| (if is_known(&entry) { None } else { heads::recognise(&entry) }, entry))
            .map(|(recognised, entry)| (entry, recognised))
            .collect();
        let is_result = |(entry, recognised): &(Entry, Option<Recognised>)| {
            (*recognised == Some(Recognised::Result)).then(|| entry.path.folder().to_owned())
        };
        let results: Vec<String> = recognised.iter().filter_map(is_result).collect();
        let is_within = |entry: &Entry| results.iter().any(|r| entry.path.below(r).is_some());
        // A run may write its result where the photographs are.
        let are_all_within = pictures.iter().all(is_within);
        let is_left = |entry: &Entry| {
            let mut names = results.iter().filter_map(|result| entry.path.below(result));
            names.any(|name| is_of_a_run(name.as_str()))
        };
        let is_own = |entry: &Entry| match are_all_within {
            true => !is_left(entry),
            false => !is_within(entry),
        };
        let mut beside = Self {
            pictures: pictures.into_iter().filter(is_own).collect(),
            others: Vec::new(),
            foreign_poses: Vec::new(),
            result: results.first().cloned(),
        };
        for (entry, recognised) in recognised.into_iter().filter(|(entry, _)| is_own(entry)) {
            match recognised {
                Some(Recognised::Foreign(program)) => beside.foreign_poses.push((entry, program)),
                Some(Recognised::Transforms) => beside.others.push(entry),
                None if is_known(&entry) => beside.others.push(entry),
                Some(Recognised::Result) | None => {}
            }
        }
        beside
    }
}

/// Whether the name of a non-picture file has a meaning.
fn is_known(entry: &Entry) -> bool {
    let is_poses = POSE_FILES.contains(&&*entry.path.name().to_ascii_lowercase());
    is_poses || is_unused(entry) || hold(entry.path.as_str()).is_some()
}

/// Whether one of these files lists poses by photograph name.
fn names_photographs(entry: &Entry) -> bool {
    let is_other = is_unused(entry) || hold(entry.path.as_str()).is_some();
    !is_other && !entry.path.name().eq_ignore_ascii_case("poses_bounds.npy")
}

/// Whether a file is listed among the photographs, accepted or not: by its extension, or without
/// one if its bytes are a picture's.
fn claims_to_be_a_photograph(entry: &Entry) -> bool {
    let path = Path::new(entry.path.name());
    named_like_a_photograph(path)
        || (path.extension().is_none() && crate::image::read_header(&entry.file).is_ok())
}

/// Whether a file is a video or in an unsupported format, which its owner may take for a
/// photograph.
fn is_unused(entry: &Entry) -> bool {
    is_video(&entry.file) || Unread::named(Path::new(entry.path.name())).is_some()
}

/// Where the photographs are. If there are only files in an unsupported format, the error names one
/// of them.
fn place_of(
    pictures: Vec<Entry>,
    poses: &[&Entry],
    unused: &[Entry],
) -> Result<Place, CaptureError> {
    let video = unused.iter().find(|entry| is_video(&entry.file));
    let unread = |entry: &Entry| {
        let path = PathBuf::from(entry.path.as_str());
        Unread::named(&path).map(|format| CaptureError::Unread { path, format })
    };
    place::find(pictures, poses, video).map_err(|error| match error {
        CaptureError::NoPhotographs { video: None, .. } => {
            unused.iter().find_map(unread).unwrap_or(error)
        }
        error => error,
    })
}

/// Removes wrapper folders, such as the one in a zip of a folder.
fn strip_wrappers(entries: &mut [Entry]) {
    loop {
        let tops: BTreeSet<Option<&str>> =
            entries.iter().map(|e| e.path.as_str().split_once('/').map(|(top, _)| top)).collect();
        let wrapper = match tops.first() {
            Some(Some(top)) if tops.len() == 1 => (*top).to_owned(),
            _ => return,
        };
        let mut known = KNOWN_FOLDERS.iter().chain(&place::MADE);
        if known.any(|known| known.eq_ignore_ascii_case(&wrapper)) {
            return;
        }
        for entry in &mut *entries {
            entry.path = entry.path.below(&wrapper).expect("all lie in the wrapper");
        }
    }
}

/// The files of `unused` that are beside the photographs, with paths relative to `folder`.
fn beside(unused: Vec<Entry>, photographs: &[Entry], folder: &str) -> Vec<Entry> {
    let folders: HashSet<&str> = photographs.iter().map(|e| e.path.folder()).collect();
    let below = |entry: Entry| {
        let path = entry.path.below(folder)?;
        folders.contains(path.folder()).then_some(Entry { path, ..entry })
    };
    unused.into_iter().filter_map(below).collect()
}

/// The position of the folder in a ground truth path.
fn truth_at(path: &PhotoPath) -> usize {
    let is_truth = |part: &str| place::TRUTH.iter().any(|t| part.eq_ignore_ascii_case(t));
    path.as_str().split('/').position(is_truth).unwrap_or(0)
}

/// Ground truth whose parent folder also has photographs: trainers write renders and the references
/// for them under numbers of their own.
fn beside_photographs(truth: Vec<Entry>, photographs: &[Entry], folder: &str) -> Vec<Entry> {
    let is_beside = |entry: &Entry| {
        let parts: Vec<&str> = entry.path.as_str().split('/').collect();
        let parent = parts[..truth_at(&entry.path)].join("/");
        let mut all = photographs.iter();
        all.any(|photograph| photograph.path.inside(folder).below(&parent).is_some())
    };
    truth.into_iter().filter(is_beside).collect()
}

/// Sharp pictures by the photographs that they show, whose names they share below their folder.
fn of_photographs(
    truth: &[Entry],
    photographs: &[Entry],
) -> Result<HashMap<PhotoPath, Entry>, Tie> {
    let below = |entry: &Entry| {
        let parts: Vec<&str> = entry.path.as_str().split('/').collect();
        PhotoPath::new(&parts[truth_at(&entry.path) + 1..].join("/"))
    };
    let names: Vec<PhotoPath> = truth.iter().map(below).collect();
    let paths: Vec<PhotoPath> = photographs.iter().map(|e| e.path.clone()).collect();
    let found = find_each(&names, &paths)?;
    let pairs = paths.into_iter().zip(found);
    Ok(pairs.filter_map(|(path, at)| Some((path, truth[at?].clone()))).collect())
}
