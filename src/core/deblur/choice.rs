//! The values of the options that name networks.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The built-in network.
pub(super) const DEFAULT: &str = "default";
/// No network: a view stays unchanged.
pub(super) const IDENTITY: &str = "identity";
const CURVE: &str = "curve";

/// The value of the options `deblur` and `enhance`, each of which allows only some of the words.
/// Serialised as one string.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum NetworkChoice {
    /// The built-in network.
    Default,
    /// No network: views stay unchanged.
    Identity,
    /// No network: the tone curve brightens.
    Curve,
    /// The built-in network's id, or the name or path of an ONNX file.
    Named(String),
}

impl NetworkChoice {
    /// The user's spelling.
    pub fn as_str(&self) -> &str {
        match self {
            Self::Default => DEFAULT,
            Self::Identity => IDENTITY,
            Self::Curve => CURVE,
            Self::Named(name) => name,
        }
    }

    /// Whether the choice is a network, by `default` or by name.
    pub fn is_network(&self) -> bool {
        matches!(self, Self::Default | Self::Named(_))
    }
}

impl From<String> for NetworkChoice {
    fn from(text: String) -> Self {
        match text.as_str() {
            DEFAULT => Self::Default,
            IDENTITY => Self::Identity,
            CURVE => Self::Curve,
            _ => Self::Named(text),
        }
    }
}

impl From<NetworkChoice> for String {
    fn from(choice: NetworkChoice) -> Self {
        match choice {
            NetworkChoice::Named(name) => name,
            word => word.as_str().to_owned(),
        }
    }
}

impl fmt::Display for NetworkChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_choice_round_trips() {
        const WORDS: [&str; 3] = [DEFAULT, IDENTITY, CURVE];
        for text in WORDS.into_iter().chain(["small-u2w16", "a/b.onnx", ""]) {
            let choice = NetworkChoice::from(text.to_owned());
            assert_eq!(choice.as_str(), text);
            assert_eq!(String::from(choice.clone()), text);
            assert_eq!(matches!(choice, NetworkChoice::Named(_)), !WORDS.contains(&text));
        }
    }
}
