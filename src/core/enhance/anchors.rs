//! The brightness of each round: geometric steps to the target.

use std::str::FromStr;

/// Above this clip limit nothing changes any more; the paper's bound.
pub const MAX_ALPHA: f64 = 15.0;

/// The paper's lower bound of gamma.
pub const MIN_GAMMA: f64 = 0.3;

/// P_0: nearly the identity, gain 1.12. 0.1 because 0 has no logarithm.
pub(super) const FIRST: Anchor = Anchor {
    alpha: 0.1,
    gamma: 1.0,
};

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

/// One brightness P = (alpha, gamma).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Clip limit of the equalisation; 0: no equalisation.
    pub alpha: f64,
    /// Exponent on all channels; below 1 brightens.
    pub gamma: f64,
}

/// A target that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("target `{text}`: {reason}")]
pub struct TargetError {
    text: String,
    reason: String,
}

/// P_1..P_N: `alpha_i = 0.1^(1-i/N) alpha_N^(i/N)`, `gamma_i = gamma_N^(i/N)`. Geometric, as that
/// gives even steps of brightness. An alpha_N of 0 stays 0 in every round.
///
/// # Panics
/// When `rounds` is 0: a fault of the caller.
pub fn anchors(rounds: u32, target: Anchor) -> Vec<Anchor> {
    assert!(rounds > 0, "at least one round");
    (1..=rounds)
        .map(|i| match i {
            i if i == rounds => target,
            i => {
                let share = f64::from(i) / f64::from(rounds);
                let alpha = FIRST.alpha.powf(1.0 - share) * target.alpha.powf(share);
                Anchor {
                    alpha,
                    gamma: target.gamma.powf(share),
                }
            }
        })
        .collect()
}

impl FromStr for Anchor {
    type Err = TargetError;

    /// Reads `alpha,gamma` or a LuSh scene's name.
    fn from_str(text: &str) -> Result<Self, TargetError> {
        let fault = |reason: &str| TargetError {
            text: text.to_owned(),
            reason: reason.to_owned(),
        };
        if let Some(&(_, gamma, alpha)) = PRESETS
            .iter()
            .find(|preset| preset.0.eq_ignore_ascii_case(text))
        {
            return Ok(Self { alpha, gamma });
        }
        let unreadable = || {
            let names: Vec<_> = PRESETS.iter().map(|preset| preset.0).collect();
            fault(&format!(
                "expected `auto`, `alpha,gamma` such as `10,0.8`, or one of {}",
                names.join(", ")
            ))
        };
        let (alpha, gamma) = text.split_once(',').ok_or_else(unreadable)?;
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| unreadable());
        let anchor = Self {
            alpha: number(alpha)?,
            gamma: number(gamma)?,
        };
        if !(0.0..=100.0).contains(&anchor.alpha) {
            return Err(fault("alpha must be in 0..=100 (above 15 nothing changes)"));
        }
        if !(0.05..=4.0).contains(&anchor.gamma) {
            return Err(fault("gamma must be in 0.05..=4"));
        }
        Ok(anchor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_rounds_to_ten_and_point_eight_pass_one_and_its_root() {
        let steps = anchors(
            2,
            Anchor {
                alpha: 10.0,
                gamma: 0.8,
            },
        );
        assert!(
            (steps[0].alpha - 1.0).abs() < 1e-12 && (steps[0].gamma - 0.8_f64.sqrt()).abs() < 1e-12
        );
        assert_eq!(
            steps[1],
            Anchor {
                alpha: 10.0,
                gamma: 0.8
            }
        );
    }

    #[test]
    fn a_target_without_equalisation_has_none_in_any_round() {
        let steps = anchors(
            3,
            Anchor {
                alpha: 0.0,
                gamma: 0.25,
            },
        );
        assert!(steps.iter().all(|anchor| anchor.alpha == 0.0));
        assert!((steps[0].gamma - 0.25_f64.powf(1.0 / 3.0)).abs() < 1e-12);
    }
}
