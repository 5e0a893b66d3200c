//! Recognises files beside photographs by their content, because users choose the names.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::entries::Entry;

/// Bytes read from each file: lists of names may precede the first pose.
const HEAD_BYTES: u64 = 1 << 20;

/// Extensions of the files whose content is read.
const EXTENSIONS: [&str; 8] = ["json", "xml", "xmp", "csv", "txt", "out", "nvm", "sfm"];

/// Files that fled writes at the top of a result, with words they contain: for a run, including one
/// shown by `make demo`, and for an evaluation.
const RESULTS: [(&str, &[&str]); 3] = [
    ("config.json", &["\"pose_source\"", "\"lut_scope\"", "\"deblur\""]),
    ("metrics.json", &["\"best_round\"", "\"gaussians\"", "\"registered\""]),
    ("evaluation.json", &["\"training_views\"", "\"tied_views\"", "\"camera_error\""]),
];

/// Words in NeRF's `transforms.json`.
const TRANSFORMS: [&str; 2] = ["\"frames\"", "\"transform_matrix\""];

/// Programs whose poses are unsupported, with words that all their files contain, in lower case.
/// The first matching row counts.
const FOREIGN: [(&str, &[&str]); 22] = [
    ("Metashape", &["<document", "<chunk", "<sensor"]),
    ("Metashape", &["#label,x/"]),
    ("Metashape", &["photoid,", "omega"]),
    ("RealityScan", &["xcr:rotation"]),
    ("RealityScan", &["xcr:poseprior"]),
    ("RealityScan", &["#name,x,y"]),
    ("ContextCapture", &["<blocksexchange", "<pose"]),
    ("Pix4D", &["omega phi kappa"]),
    ("Bundler", &["# bundle file"]),
    ("VisualSFM", &["nvm_v3"]),
    ("OpenMVG", &["\"sfm_data_version\"", "\"extrinsics\""]),
    ("Meshroom", &["\"viewid\"", "\"poses\""]),
    ("OpenSfM", &["\"cameras\"", "\"shots\"", "\"rotation\""]),
    ("Polycam", &["\"t_00\"", "\"t_23\""]),
    ("SDFStudio", &["\"frames\"", "\"camtoworld\""]),
    ("EyefulTower", &["\"krt\"", "\"cameraid\""]),
    ("Record3D", &["\"poses\"", "\"k\""]),
    ("the trainer that wrote them", &["\"img_name\"", "\"position\"", "\"rotation\""]),
    ("kapture", &["# kapture format", "qw, qx"]),
    ("MVSNet", &["extrinsic\n", "intrinsic\n"]),
    ("the program that wrote them", &["# timestamp tx ty tz"]),
    (
        "COLMAP, whose files are called cameras.txt and images.txt,",
        &["# image list with two lines"],
    ),
];

/// Files recognised by path alone: parts of the path, and the programs that write them.
const FOREIGN_NAMES: [(&str, &str); 4] = [
    (".rcproj", "RealityScan"),
    ("/cameras_sphere.npz", "IDR and NeuS"),
    ("/cameras.npz", "IDR and NeuS"),
    ("/pose/", "NSVF"),
];

/// The kind of a recognised file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Recognised {
    /// A file at the top of a fled result.
    Result,
    /// NeRF poses, whatever the file's name.
    Transforms,
    /// Poses in the unsupported format of this program.
    Foreign(&'static str),
}

/// Whether the content of files with this name is read.
pub(super) fn is_recognisable(name: &str) -> bool {
    let extension = Path::new(name).extension().and_then(|extension| extension.to_str());
    extension.is_some_and(|own| EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(own)))
}

/// The kind of a non-picture file, if it is recognised.
pub(super) fn recognise(entry: &Entry) -> Option<Recognised> {
    let path = format!("/{}", entry.path.as_str().to_ascii_lowercase());
    let by_name = || { FOREIGN_NAMES.iter() }.find(|(part, _)| path.contains(part));
    let by_name = || by_name().map(|(_, program)| Recognised::Foreign(program));
    if !is_recognisable(&path) {
        return by_name();
    }
    let head = head(&entry.file).unwrap_or_default();
    let has = |words: &[&str]| words.iter().all(|word| head.contains(word));
    let name = path.rsplit('/').next().unwrap_or_default();
    if RESULTS.iter().any(|(own, words)| *own == name && has(words)) {
        return Some(Recognised::Result);
    }
    if name.ends_with(".json") && has(&TRANSFORMS) {
        return Some(Recognised::Transforms);
    }
    let foreign = FOREIGN.iter().find(|(_, words)| has(words));
    foreign.map(|(program, _)| Recognised::Foreign(program)).or_else(by_name)
}

/// The beginning of a text file, in lower case; `None` for other files.
fn head(file: &Path) -> Option<String> {
    let mut bytes = Vec::new();
    File::open(file).ok()?.take(HEAD_BYTES).read_to_end(&mut bytes).ok()?;
    // Windows also writes XML and text in UTF-16.
    let text = match &bytes[..] {
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        bytes if bytes.contains(&0) => return None,
        bytes => String::from_utf8_lossy(bytes).into_owned(),
    };
    Some(text.replace('\r', "").to_ascii_lowercase())
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
}
