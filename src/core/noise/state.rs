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
    /// The numbers are no state of this version and network.
    #[error("not the state of such a noise field: {0}")]
    Format(&'static str),
    /// The device failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

impl NoiseField {
    /// The state for [`NoiseField::restore`]: step, parameters and moments. Waits for the device.
    ///
    /// # Errors
    /// A device error.
    pub fn save(&self) -> Result<Vec<f32>, GpuError> {
        // Steps are far below 2^24, up to which f32 is exact.
        let mut state = vec![VERSION, self.step as f32];
        for buffer in [&self.buffers.parameters, &self.buffers.moments] {
            state.extend(buffer.read()?.as_flattened());
        }
        Ok(state)
    }

    /// Restores a state of [`NoiseField::save`].
    ///
    /// # Errors
    /// [`StateError::Format`] for invalid numbers, which change nothing; a device error.
    pub fn restore(&mut self, state: &[f32]) -> Result<(), StateError> {
        let parameters = 4 * self.network.parameters();
        let (&[version, step], numbers) = state
            .split_first_chunk::<HEADER>()
            .filter(|(_, numbers)| numbers.len() == 3 * parameters)
            .ok_or(StateError::Format("the length differs"))?;
        if version != VERSION {
            return Err(StateError::Format("another version"));
        }
        let (values, moments) = numbers.split_at(parameters);
        self.buffers.parameters.write(bytemuck::cast_slice(values))?;
        self.buffers.moments.write(bytemuck::cast_slice(moments))?;
        self.step = step as u64;
        Ok(())
    }
}
