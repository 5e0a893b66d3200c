//! A number that may be left to the pipeline.

use schemars::{Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A number, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// The pipeline chooses.
    Auto,
    /// The pipeline's choice for this machine; a verdict on the capture may lower it.
    Fitted(u32),
    /// The user's choice, or the preset's, which is obeyed.
    Given(u32),
}

impl Setting {
    /// The number, or `usual` where the pipeline chooses.
    pub fn or(self, usual: u32) -> u32 {
        match self {
            Self::Auto => usual,
            Self::Fitted(number) | Self::Given(number) => number,
        }
    }

    /// Whether the pipeline chooses.
    pub fn is_open(self) -> bool {
        !matches!(self, Self::Given(_))
    }
}

impl Serialize for Setting {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Auto => serializer.serialize_str("auto"),
            Self::Fitted(number) | Self::Given(number) => serializer.serialize_u32(*number),
        }
    }
}

/// The JSON forms of a setting.
#[derive(Deserialize)]
#[serde(untagged, expecting = "must be a whole number or `auto`")]
enum Written {
    Number(u32),
    Word(Word),
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Word {
    Auto,
}

impl<'de> Deserialize<'de> for Setting {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match Written::deserialize(deserializer)? {
            Written::Number(number) => Self::Given(number),
            Written::Word(Word::Auto) => Self::Auto,
        })
    }
}

/// The schema of a setting with a number from `LEAST` to `MOST`.
pub(super) fn schema<const LEAST: u32, const MOST: u32>(_: &mut SchemaGenerator) -> Schema {
    json_schema!({
        "anyOf": [
            { "type": "integer", "minimum": LEAST, "maximum": MOST },
            { "type": "string", "const": "auto" }
        ]
    })
}
