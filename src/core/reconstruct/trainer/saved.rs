//! Saves the state of a round to a checkpoint, and restores it.

use super::Trainer;
use crate::noise::StateError;
use crate::reconstruct::checkpoint::Checkpoint;
use crate::reconstruct::observed::Observed;
use crate::reconstruct::training::TrainingState;
use crate::reconstruct::{ReconstructError, TrainConfig};

impl Trainer<'_> {
    /// The state before step `next`, with nothing in flight.
    pub(super) fn checkpoint(&self) -> Result<Checkpoint, ReconstructError> {
        Ok(Checkpoint {
            fingerprint: self.fingerprint(),
            step: self.next,
            steps: self.schedule.steps,
            start_count: self.start_count as u32,
            cap: self.config.cap as u64,
            seconds: self.seconds(),
            state: self.scene.save()?,
            shake: self.model.save_kernels(),
            motions: self.model.save_motions(),
        })
    }

    pub(super) fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), ReconstructError> {
        if checkpoint.fingerprint != self.fingerprint() || checkpoint.step > checkpoint.steps {
            return Err(ReconstructError::OtherRound);
        }
        self.restore_scene(&checkpoint.state)?;
        self.schedule.steps = checkpoint.steps;
        self.start_count = checkpoint.start_count as usize;
        self.seconds_before = checkpoint.seconds;
        self.next = checkpoint.step;
        // The level before this step: `prepare` changes it at the same point as in an uninterrupted
        // round.
        let divisor = self.schedule.divisor(self.next.saturating_sub(1));
        self.set_level(divisor)?;
        self.model.restore_kernels(&checkpoint.shake)?;
        self.model.restore_motions(&checkpoint.motions)
    }

    pub(super) fn restore_scene(&mut self, state: &TrainingState) -> Result<(), ReconstructError> {
        self.scene.restore(state).map_err(|error| match error {
            StateError::Gpu(error) => error.into(),
            StateError::Format(_) => ReconstructError::Noise(error.to_string()),
        })
    }

    /// Hash of config and views, but not of the cap, which may be lowered in mid training.
    fn fingerprint(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        let config = TrainConfig { cap: 0, ..self.config.clone() };
        hasher.update(format!("{config:?}").as_bytes());
        for view in self.model.views.iter().map(Observed::given) {
            hasher.update(format!("{} {:?}", view.name, view.camera).as_bytes());
        }
        let hash = hasher.finalize();
        u64::from_le_bytes(*hash.as_bytes().first_chunk().expect("a hash has 32 bytes"))
    }
}
