//! The brightness of each round: even steps to the target.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Clip limit beyond which nothing changes; the paper's bound.
pub const MAX_ALPHA: f64 = 15.0;

/// The paper's lower bound of gamma.
pub const MIN_GAMMA: f64 = 0.3;

/// Alpha of the paper's P_0, which is nearly the identity (gain 1.12): 0 has no logarithm.
pub(super) const FIRST_ALPHA: f64 = 0.1;

/// Bounds of an exposure in the options, stops.
const STOPS: std::ops::RangeInclusive<f64> = -4.0..=16.0;

/// Published (gamma, alpha) of the LuSh-NeRF scenes.
const PRESETS: [(&str, f64, f64); 10] = [
    ("plane", 0.8, 30.0),
    ("poster", 1.0, 10.0),
    ("sakura", 0.8, 15.0),
    ("hall", 0.4, 3.0),
    ("dorm", 0.8, 20.0),
    ("campus", 0.4, 5.0),
    ("car", 0.25, 0.0),
    ("highway", 0.5, 10.0),
    ("neighborhood", 0.5, 10.0),
    ("signboard", 0.5, 10.0),
];

/// A brightness P.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged, from = "Written")]
pub enum Anchor {
    /// A longer exposure: a gain in linear light with a soft shoulder for highlights.
    ///
    /// Differs from the paper: its curves, even the closest one, reach 27 to 35 dB against a
    /// longer exposure, and this one 42 to 48 (docs/decisions/target.md).
    Exposure {
        /// Stops: the gain is `2^ev`.
        ev: f64,
        /// Light subtracted after the gain, white being 1. Fitted for renders; 0 for photographs.
        black: f64,
    },
    /// The paper's family: clip-limited equalisation of the histogram, then an exponent.
    Equalised {
        /// Clip limit; 0 disables equalisation.
        alpha: f64,
        /// Exponent on all channels; below 1 brightens.
        gamma: f64,
    },
}

/// The serialised forms of an anchor.
#[derive(Deserialize, JsonSchema)]
#[serde(untagged)]
enum Written {
    Exposure {
        ev: f64,
        black: f64,
    },
    Equalised {
        alpha: f64,
        gamma: f64,
    },
    /// Alpha and gamma in reports of earlier versions.
    Pair([f64; 2]),
}

impl From<Written> for Anchor {
    fn from(written: Written) -> Self {
        match written {
            Written::Exposure { ev, black } => Self::Exposure { ev, black },
            Written::Equalised { alpha, gamma } | Written::Pair([alpha, gamma]) => {
                Self::Equalised { alpha, gamma }
            }
        }
    }
}

impl Anchor {
    /// A gain of `ev` stops.
    pub fn exposure(ev: f64) -> Self {
        Self::Exposure { ev, black: 0.0 }
    }

    /// The mean of several anchors of one family.
    ///
    /// # Panics
    /// Without anchors, or with two families: faults of the caller.
    pub fn mean(anchors: &[Self]) -> Self {
        let mean = |number: fn(&Self) -> f64| {
            anchors.iter().map(number).sum::<f64>() / anchors.len() as f64
        };
        let (first, second) =
            (mean(|anchor| anchor.numbers()[0]), mean(|anchor| anchor.numbers()[1]));
        match anchors.first().expect("an anchor or more") {
            Self::Exposure { .. } => Self::Exposure { ev: first, black: second },
            Self::Equalised { .. } => Self::Equalised { alpha: first, gamma: second },
        }
    }

    fn numbers(self) -> [f64; 2] {
        match self {
            Self::Exposure { ev, black } => [ev, black],
            Self::Equalised { alpha, gamma } => [alpha, gamma],
        }
    }
}

impl fmt::Display for Anchor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exposure { ev, .. } => write!(f, "{ev:+.2} EV"),
            Self::Equalised { alpha, gamma } => write!(f, "alpha {alpha:.3}, gamma {gamma:.3}"),
        }
    }
}

/// An invalid target.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("target `{text}`: {reason}")]
pub struct TargetError {
    text: String,
    reason: String,
}

/// P_1..P_N. Exposures rise by equal stops. In the paper's family
/// `alpha_i = 0.1^(1-i/N) alpha_N^(i/N)`, `gamma_i = gamma_N^(i/N)`: geometric, which gives even
/// steps of brightness; an alpha_N of 0 stays 0 in every round.
///
/// # Panics
/// When `rounds` is 0: a fault of the caller.
pub fn anchors(rounds: u32, target: Anchor) -> Vec<Anchor> {
    assert!(rounds > 0, "at least one round");
    let before_last = |share: f64| match target {
        Anchor::Exposure { ev, .. } => Anchor::exposure(share * ev),
        Anchor::Equalised { alpha, gamma } => Anchor::Equalised {
            alpha: FIRST_ALPHA.powf(1.0 - share) * alpha.powf(share),
            gamma: gamma.powf(share),
        },
    };
    (1..rounds).map(|i| before_last(f64::from(i) / f64::from(rounds))).chain([target]).collect()
}

impl FromStr for Anchor {
    type Err = TargetError;

    /// Parses stops (`+3.5EV`), `alpha,gamma`, or the name of a LuSh scene.
    fn from_str(text: &str) -> Result<Self, TargetError> {
        let fault = |reason: &str| TargetError { text: text.to_owned(), reason: reason.to_owned() };
        if let Some(&(_, gamma, alpha)) =
            PRESETS.iter().find(|preset| preset.0.eq_ignore_ascii_case(text))
        {
            return Ok(Self::Equalised { alpha, gamma });
        }
        let unreadable = || {
            let names: Vec<_> = PRESETS.iter().map(|preset| preset.0).collect();
            fault(&format!(
                "expected `auto`, stops such as `+3.5EV`, `auto-paper`, `alpha,gamma` such as \
                 `10,0.8`, or one of {}",
                names.join(", ")
            ))
        };
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| unreadable());
        if let Some(stops) = text.to_ascii_lowercase().strip_suffix("ev") {
            let ev = number(stops)?;
            if !STOPS.contains(&ev) {
                return Err(fault("stops must be in -4..=16"));
            }
            return Ok(Self::exposure(ev));
        }
        let (alpha, gamma) = text.split_once(',').ok_or_else(unreadable)?;
        let (alpha, gamma) = (number(alpha)?, number(gamma)?);
        if !(0.0..=100.0).contains(&alpha) {
            return Err(fault("alpha must be in 0..=100 (above 15 nothing changes)"));
        }
        if !(0.05..=4.0).contains(&gamma) {
            return Err(fault("gamma must be in 0.05..=4"));
        }
        Ok(Self::Equalised { alpha, gamma })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposures_rise_by_equal_stops() {
        assert_eq!(anchors(3, Anchor::exposure(3.0)), [1.0, 2.0, 3.0].map(Anchor::exposure));
    }

    #[test]
    fn anchors_of_the_papers_family_are_geometric() {
        let target = Anchor::Equalised { alpha: 10.0, gamma: 0.8 };
        let steps = anchors(2, target);
        let [alpha, gamma] = steps[0].numbers();
        assert!((alpha - 1.0).abs() < 1e-12 && (gamma - 0.8_f64.sqrt()).abs() < 1e-12);
        assert_eq!(steps[1], target);
    }

    #[test]
    fn without_equalisation_no_round_has_any() {
        let target = Anchor::Equalised { alpha: 0.0, gamma: 0.25 };
        let steps = anchors(3, target);
        assert!(steps.iter().all(|anchor| anchor.numbers()[0] == 0.0));
        assert!((steps[0].numbers()[1] - 0.25_f64.powf(1.0 / 3.0)).abs() < 1e-12);
    }

    #[test]
    fn anchors_round_trip_and_pairs_can_still_be_read() {
        for anchor in [
            Anchor::Exposure { ev: 3.5, black: 0.01 },
            Anchor::Equalised { alpha: 10.0, gamma: 0.8 },
        ] {
            let written = serde_json::to_string(&anchor).expect("JSON");
            assert_eq!(serde_json::from_str::<Anchor>(&written).expect("reads"), anchor);
        }
        let pair: Anchor = serde_json::from_str("[10.0, 0.8]").expect("a pair");
        assert_eq!(pair.numbers(), [10.0, 0.8]);
    }
}
