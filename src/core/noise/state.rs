//! The state of the field as numbers, for checkpoints.

use fled_gpu::GpuError;

use super::NoiseField;

/// First number of a state: the version of its layout.
const VERSION: f32 = 3.0;
/// Number of values before the parameters: version, step.
const HEADER: usize = 2;

/// A state that cannot be restored.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The numbers are not a state of this version and network.
    #[error("not the state of such a noise field: {0}")]
    Format(&'static str),
    /// The device failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// The state of a field: `numbers` are the parameters and the first and second moments.
pub(super) fn pack(step: u64, numbers: &[&[f32]]) -> Vec<f32> {
    // Steps are far below 2^24, up to which f32 is exact.
    [&[VERSION, step as f32], numbers.concat().as_slice()].concat()
}

/// Step and numbers of [`pack`] for a network with this many parameters.
pub(super) fn parse(state: &[f32], parameters: usize) -> Result<(u64, &[f32]), StateError> {
    let (&[version, step], numbers) = state
        .split_first_chunk::<HEADER>()
        .filter(|(_, numbers)| numbers.len() == 3 * parameters)
        .ok_or(StateError::Format("the length differs"))?;
    if version != VERSION {
        return Err(StateError::Format("another version"));
    }
    Ok((step as u64, numbers))
}

impl NoiseField {
    /// The state for [`NoiseField::restore`]: step, parameters and moments. Waits for the device.
    ///
    /// # Errors
    /// A device error.
    pub fn save(&self) -> Result<Vec<f32>, GpuError> {
        let b = &self.buffers;
        let (parameters, moments) = (b.parameters.read()?, b.moments.read()?);
        Ok(pack(self.step, &[parameters.as_flattened(), moments.as_flattened()]))
    }

    /// Restores a state of [`NoiseField::save`].
    ///
    /// # Errors
    /// [`StateError::Format`] for invalid numbers, which change nothing; a device error.
    pub fn restore(&mut self, state: &[f32]) -> Result<(), StateError> {
        let parameters = 4 * self.network.parameters();
        let (step, numbers) = parse(state, parameters)?;
        let (values, moments) = numbers.split_at(parameters);
        self.buffers.parameters.write(bytemuck::cast_slice(values))?;
        self.buffers.moments.write(bytemuck::cast_slice(moments))?;
        self.step = step;
        Ok(())
    }
}
