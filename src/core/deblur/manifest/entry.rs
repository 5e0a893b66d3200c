//! One network of the manifest.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::files::{Place, embedded, find, is_file_name, read};
use super::model::Model;
use crate::deblur::choice::RESERVED;
use crate::deblur::{DeblurError, Golden};
use crate::inference::digest;

/// Whether a network takes a guide.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Three channels: the view.
    Single,
    /// Six channels: the blurry view, then the guide.
    Guided,
}

/// One known network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// What `deblur=` takes.
    pub id: String,
    /// Whether it takes a guide.
    pub role: Role,
    /// File name; absent where the user makes the file.
    pub file: Option<String>,
    /// Where the file can be had.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub url: Option<String>,
    /// Who made it, when it is ours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
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
    /// Name of the input, which has to be the file's; absent: whatever the file says.
    pub input: Option<String>,
    /// Name of the output that is the restored view, where the file has several; absent: the first
    /// one.
    pub output: Option<String>,
    /// File of the output that the self-test expects ([`Golden`]); absent: it is made on the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub golden: Option<String>,
    /// Whether `deblur=default` means this one.
    pub default: bool,
    /// Whether it is this one instead where CUDA runs it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub default_on_cuda: bool,
    /// False until somebody has fetched and run it.
    #[serde(default = "yes")]
    pub verified: bool,
    /// What else to know.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

fn yes() -> bool {
    true
}

impl Entry {
    /// The entry of a file of which no more is known than its input channels, checksum and size in
    /// bytes.
    pub fn of_file(id: &str, channels: u32, sha256: String, bytes: u64) -> Self {
        let guided = channels == 6;
        let model = Model::unknown(String::new(), Vec::new());
        Self {
            id: id.to_owned(),
            role: if guided { Role::Guided } else { Role::Single },
            file: None,
            url: None,
            source: None,
            sha256: Some(sha256),
            bytes: Some(bytes),
            licence: "unknown".to_owned(),
            channels,
            order: ["blurry", "guide"][..if guided { 2 } else { 1 }]
                .iter()
                .map(ToString::to_string)
                .collect(),
            multiple: model.multiple,
            minimum_side: model.minimum_side,
            tile: model.tile,
            range: model.range,
            input: None,
            output: None,
            golden: None,
            default: false,
            default_on_cuda: false,
            verified: true,
            note: None,
        }
    }

    /// The network, its file found and its checksum right.
    ///
    /// # Errors
    /// [`DeblurError::ModelFileMissing`], [`DeblurError::ModelUnreadable`] or
    /// [`DeblurError::ModelChecksum`].
    pub fn load(&self, directories: &[PathBuf]) -> Result<Model, DeblurError> {
        let bytes = match self.place(directories) {
            Place::BuiltIn => embedded(self.file.as_deref()).unwrap_or_default().to_vec(),
            Place::File(path) => read(&path)?,
            Place::Missing => return Err(self.missing(directories)),
        };
        self.checked(bytes, self.golden_file(directories)?.as_deref())
    }

    /// What the self-test expects, where the entry names a file of it: then it has to be there.
    ///
    /// # Errors
    /// [`DeblurError::ModelFileMissing`] or [`DeblurError::ModelUnreadable`].
    pub fn golden_file(&self, directories: &[PathBuf]) -> Result<Option<Vec<u8>>, DeblurError> {
        let Some(name) = &self.golden else {
            return Ok(None);
        };
        if let Some(bytes) = embedded(Some(name)) {
            return Ok(Some(bytes.to_vec()));
        }
        let advice = format!(
            "Its {name} is missing; take the network up again: fled models add FILE --id {}",
            self.id
        );
        let missing = || DeblurError::ModelFileMissing {
            id: self.id.clone(),
            advice,
        };
        read(&find(Some(name), directories).ok_or_else(missing)?).map(Some)
    }

    /// Whether its file is part of this program.
    pub fn built_in(&self) -> bool {
        embedded(self.file.as_deref()).is_some()
    }

    /// Whether a file of this name, golden or not, is this entry's.
    pub(in crate::deblur) fn owns(&self, name: &str) -> bool {
        [&self.file, &self.golden]
            .into_iter()
            .any(|own| own.as_deref() == Some(name))
    }

    /// Where its file is.
    pub fn place(&self, directories: &[PathBuf]) -> Place {
        // What is built in wins: a stray file of the same name must not break the default.
        if self.built_in() {
            return Place::BuiltIn;
        }
        find(self.file.as_deref(), directories).map_or(Place::Missing, Place::File)
    }

    /// The network in `bytes`, its checksum right; `golden` is what its self-test expects.
    ///
    /// # Errors
    /// [`DeblurError::ModelChecksum`], or [`DeblurError::SelfTest`] when `golden` is damaged.
    pub fn checked(&self, bytes: Vec<u8>, golden: Option<&[u8]>) -> Result<Model, DeblurError> {
        let sha256 = digest(&bytes);
        match &self.sha256 {
            Some(expected) if *expected != sha256 => {
                return Err(DeblurError::ModelChecksum {
                    id: self.id.clone(),
                    expected: expected.clone(),
                    actual: sha256,
                });
            }
            _ => {}
        }
        let golden = golden.map(Golden::from_bytes).transpose();
        let golden = golden.map_err(|detail| DeblurError::SelfTest {
            id: self.id.clone(),
            detail,
        })?;
        Ok(Model {
            id: self.id.clone(),
            sha256,
            bytes,
            channels: Some(self.channels),
            input: self.input.clone(),
            output: self.output.clone(),
            multiple: self.multiple,
            minimum_side: self.minimum_side,
            tile: self.tile,
            range: self.range,
            golden,
        })
    }

    /// What a hand-written entry may have wrong.
    ///
    /// # Errors
    /// A sentence.
    pub fn check(&self) -> Result<(), String> {
        let wrong = |what: &str| Err(format!("entry `{}`: {what}", self.id));
        let named = |name: &Option<String>| name.as_deref().is_none_or(is_file_name);
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if self.id.is_empty() || self.id.starts_with('.') || !self.id.chars().all(plain) {
            return wrong(
                "an id is made of letters, digits, `-`, `_` and `.`, and does not begin with `.`",
            );
        }
        if RESERVED.contains(&self.id.as_str()) {
            return wrong("`default`, `identity`, `same` and `curve` mean something else");
        }
        if !named(&self.file) || !named(&self.golden) {
            return wrong(
                "`file` and `golden` are names of files beside the manifest, without a folder",
            );
        }
        let guided = self.role == Role::Guided;
        let order: &[&str] = if guided {
            &["blurry", "guide"]
        } else {
            &["blurry"]
        };
        if self.channels != if guided { 6 } else { 3 } || self.order != order {
            return wrong(
                "a guided network takes 6 channels in the order blurry, guide; a single one takes the 3 of blurry",
            );
        }
        let sides = (1..=256).contains(&self.multiple)
            && (1..=4096).contains(&self.minimum_side)
            && (128..=8192).contains(&self.tile);
        if !sides || self.range[0] >= self.range[1] {
            return wrong(
                "`multiple` is 1 to 256, `minimum_side` 1 to 4096, `tile` 128 to 8192, and `range` rises",
            );
        }
        let hexadecimal = |text: &String| {
            text.len() == 64 && text.chars().all(|c| matches!(c, '0'..='9' | 'a'..='f'))
        };
        if !self.sha256.as_ref().is_none_or(hexadecimal) {
            return wrong("`sha256` is 64 lower-case hexadecimal digits");
        }
        Ok(())
    }

    fn missing(&self, directories: &[PathBuf]) -> DeblurError {
        let mut advice = match (&self.file, &self.url) {
            (Some(file), Some(url)) => format!(
                "`fled models fetch {id}` gets it from {url}; or put it as {file} into one of",
                id = self.id
            ),
            _ => "Make or get the file and `fled models add` it; known directories are".to_owned(),
        };
        for directory in directories {
            let _ = write!(advice, " {}", directory.display());
        }
        if let Some(note) = &self.note {
            let _ = write!(advice, ". {note}");
        }
        DeblurError::ModelFileMissing {
            id: self.id.clone(),
            advice,
        }
    }
}
