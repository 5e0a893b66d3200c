//! The networks that fled knows: `models/manifest.json`, and the one that is built in.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use sha2::{Digest, Sha256};

use crate::deblur::DeblurError;

const MANIFEST: &str = include_str!("../../../models/manifest.json");

/// The files that are part of the binary, by the manifest's file name.
const EMBEDDED: [(&str, &[u8]); 1] =
    [("small-u2w16.onnx", include_bytes!("../../../models/small-u2w16.onnx"))];

/// What a network may return for values in 0..=1 when nothing else is known about it: the bounds
/// of the published NAFNets, outside which they have failed (deblur.md).
const USUAL_RANGE: [f32; 2] = [-1.0, 2.0];

/// All known networks.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// In the order of the file.
    pub models: Vec<Entry>,
}

/// Whether a network takes a guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Three channels: the blurry view.
    Single,
    /// Six channels: the blurry view, then the guide.
    Guided,
}

/// One known network.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// What `deblur=` takes.
    pub id: String,
    /// Whether it takes a guide.
    pub role: Role,
    /// File name; absent where the user makes the file.
    pub file: Option<String>,
    /// Where the file can be had.
    #[serde(default)]
    pub url: Option<String>,
    /// Who made it, when it is ours.
    #[serde(default)]
    pub source: Option<String>,
    /// Of the file, lower-case hexadecimal; absent where the publisher pins none.
    pub sha256: Option<String>,
    /// Size of the file.
    pub bytes: Option<u64>,
    /// SPDX expression.
    pub licence: String,
    /// Input channels.
    pub channels: u32,
    /// What the channels are, three each.
    pub order: Vec<String>,
    /// Both sides must be a multiple of this, px.
    pub multiple: usize,
    /// Least length of a side, px.
    pub minimum_side: usize,
    /// Side of a tile of large views, px.
    pub tile: usize,
    /// Least and greatest sane output for input in 0..=1.
    pub range: [f32; 2],
    /// Name of the input; absent: whatever the file says.
    pub input: Option<String>,
    /// Name of the output; absent: whatever the file says.
    pub output: Option<String>,
    /// Whether `deblur=default` means this one.
    pub default: bool,
    /// False until somebody has fetched and run it.
    #[serde(default = "yes")]
    pub verified: bool,
    /// What else to know.
    #[serde(default)]
    pub note: Option<String>,
}

fn yes() -> bool {
    true
}

/// A network that is ready to be loaded: checked bytes, and how to feed them.
#[derive(Clone, Debug)]
pub struct Model {
    /// Manifest id or file name.
    pub id: String,
    /// Of `bytes`.
    pub sha256: String,
    /// The ONNX file.
    pub bytes: Vec<u8>,
    /// Input channels; `None`: to be read from the file.
    pub channels: Option<u32>,
    /// Both sides must be a multiple of this, px.
    pub multiple: usize,
    /// Least length of a side, px.
    pub minimum_side: usize,
    /// Side of a tile of large views, px.
    pub tile: usize,
    /// Least and greatest sane output for input in 0..=1.
    pub range: [f32; 2],
}

impl Manifest {
    /// The manifest of this build.
    pub fn embedded() -> Self {
        serde_json::from_str(MANIFEST).expect("a test reads the embedded manifest")
    }

    /// What may be chosen without naming a file: `default`, `identity` and the ids.
    pub fn choices(&self) -> Vec<&str> {
        let ids = self.models.iter().map(|entry| entry.id.as_str());
        ["default", "identity"].into_iter().chain(ids).collect()
    }

    /// The network that `choice` means: `default`, an id, or the path of an ONNX file. Files of
    /// known networks that are not built in are looked for in `directories`.
    ///
    /// # Errors
    /// [`DeblurError::UnknownModel`], [`DeblurError::ModelFileMissing`],
    /// [`DeblurError::ModelUnreadable`] or [`DeblurError::ModelChecksum`].
    pub fn resolve(&self, choice: &str, directories: &[PathBuf]) -> Result<Model, DeblurError> {
        let wanted = |entry: &&Entry| entry.id == choice || (choice == "default" && entry.default);
        if let Some(entry) = self.models.iter().find(wanted) {
            return entry.checked(entry.read(directories)?);
        }
        let path = Path::new(choice);
        if path.is_file() {
            return self.by_path(path);
        }
        let known = self.models.iter().map(|entry| entry.id.as_str()).collect::<Vec<_>>().join(", ");
        Err(DeblurError::UnknownModel { choice: choice.to_owned(), known })
    }

    /// A file named by its path: a known network if its checksum says so, else taken as it is.
    fn by_path(&self, path: &Path) -> Result<Model, DeblurError> {
        let bytes = read(path)?;
        let sha256 = digest(&bytes);
        if let Some(entry) = self.models.iter().find(|entry| entry.sha256.as_ref() == Some(&sha256)) {
            return entry.checked(bytes);
        }
        let id = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let (multiple, minimum_side, tile) = (16, 16, 1024);
        Ok(Model { id, sha256, bytes, channels: None, multiple, minimum_side, tile, range: USUAL_RANGE })
    }
}

impl Entry {
    fn read(&self, directories: &[PathBuf]) -> Result<Vec<u8>, DeblurError> {
        let Some(file) = &self.file else { return Err(self.missing(directories)) };
        if let Some((_, bytes)) = EMBEDDED.iter().find(|(name, _)| name == file) {
            return Ok(bytes.to_vec());
        }
        let path = directories.iter().map(|directory| directory.join(file)).find(|path| path.is_file());
        read(&path.ok_or_else(|| self.missing(directories))?)
    }

    fn checked(&self, bytes: Vec<u8>) -> Result<Model, DeblurError> {
        let sha256 = digest(&bytes);
        match &self.sha256 {
            Some(expected) if *expected != sha256 => Err(DeblurError::ModelChecksum {
                id: self.id.clone(),
                expected: expected.clone(),
                actual: sha256,
            }),
            _ => Ok(Model {
                id: self.id.clone(),
                sha256,
                bytes,
                channels: Some(self.channels),
                multiple: self.multiple,
                minimum_side: self.minimum_side,
                tile: self.tile,
                range: self.range,
            }),
        }
    }

    fn missing(&self, directories: &[PathBuf]) -> DeblurError {
        let mut advice = match (&self.file, &self.url) {
            (Some(file), Some(url)) => format!("Download {url} and put it as {file} into one of"),
            _ => "Make or get the file and give its path instead; known directories are".to_owned(),
        };
        for directory in directories {
            let _ = write!(advice, " {}", directory.display());
        }
        if let Some(note) = &self.note {
            let _ = write!(advice, ". {note}");
        }
        DeblurError::ModelFileMissing { id: self.id.clone(), advice }
    }
}

fn read(path: &Path) -> Result<Vec<u8>, DeblurError> {
    std::fs::read(path).map_err(|source| DeblurError::ModelUnreadable { path: path.to_path_buf(), source })
}

fn digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::with_capacity(64), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_network_is_built_in_and_is_the_file_that_the_manifest_names() {
        let manifest = Manifest::embedded();
        let model = manifest.resolve("default", &[]).expect("embedded");
        let entry = manifest.models.iter().find(|entry| entry.default).expect("a default");
        assert_eq!(Some(&model.sha256), entry.sha256.as_ref());
        assert_eq!(entry.bytes, Some(model.bytes.len() as u64));
        assert_eq!((model.channels, entry.role), (Some(6), Role::Guided));
    }

    #[test]
    fn ids_are_unique_and_channels_agree_with_role_and_order() {
        let manifest = Manifest::embedded();
        for (index, entry) in manifest.models.iter().enumerate() {
            assert!(manifest.models[..index].iter().all(|other| other.id != entry.id), "{}", entry.id);
            assert_eq!(entry.channels, 3 * entry.order.len() as u32, "{}", entry.id);
            assert_eq!(entry.role == Role::Guided, entry.channels == 6, "{}", entry.id);
            assert!(!entry.licence.is_empty() && entry.order[0] == "blurry", "{}", entry.id);
        }
        assert_eq!(manifest.models.iter().filter(|entry| entry.default).count(), 1);
    }

    #[test]
    fn a_damaged_file_is_refused_by_its_checksum() {
        let directory = tempfile::tempdir().expect("temporary directory");
        std::fs::write(directory.path().join("NAFNet-GoPro-width32.onnx"), "damaged").expect("write");
        let refused = Manifest::embedded()
            .resolve("nafnet-gopro-w32", &[directory.path().to_path_buf()])
            .expect_err("not the file");
        assert!(matches!(refused, DeblurError::ModelChecksum { .. }), "{refused}");
    }

    #[test]
    fn a_network_whose_file_is_missing_says_where_to_get_it() {
        let missing = Manifest::embedded().resolve("nafnet-gopro-w32", &["data/models".into()]);
        let text = missing.expect_err("not here").to_string();
        assert!(text.contains("https://") && text.contains("data/models"), "{text}");
        let by_hand = Manifest::embedded().resolve("deepdeblurrf-official", &[]).expect_err("no file");
        assert!(by_hand.to_string().contains("give its path"), "{by_hand}");
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let unknown = Manifest::embedded().resolve("nafnet", &[]).expect_err("unknown");
        assert!(unknown.to_string().contains("small-u2w16"), "{unknown}");
    }

    #[test]
    fn a_known_file_given_by_path_keeps_its_identity() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/small-u2w16.onnx");
        let model = Manifest::embedded().resolve(&path.display().to_string(), &[]).expect("present");
        assert_eq!(model.id, "small-u2w16");
    }
}
