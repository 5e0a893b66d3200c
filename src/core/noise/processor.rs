//! The noise field for processors: its initial parameters, its state for checkpoints, which is that
//! of a GPU's field, and its inspection.

use fled_cpu::noise::{NoiseField, PARAMETERS};

pub use super::inspection::compare;
use super::network::Network;
use super::{StateError, state};

/// A new field, with the same parameters as a GPU's of that seed.
pub fn field(seed: u64) -> NoiseField {
    NoiseField::new(0, Network::new().initial(seed)).expect("both have the network's layout")
}

/// The state for [`restore`], and for [`NoiseField::restore`](super::NoiseField::restore).
pub fn save(field: &NoiseField) -> Vec<f32> {
    state::pack(field.step(), &[field.numbers()])
}

/// The field of a state that this or a GPU's field saved.
///
/// # Errors
/// [`StateError::Format`] for invalid numbers.
pub fn restore(state: &[f32]) -> Result<NoiseField, StateError> {
    let (step, numbers) = state::parse(state, PARAMETERS)?;
    NoiseField::new(step, numbers.to_vec()).ok_or(StateError::Format("the length differs"))
}
