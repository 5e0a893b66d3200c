//! Saves the state of a round to a checkpoint, and restores it.

use super::Trainer;
use crate::noise::NoiseField;
use crate::reconstruct::ReconstructError;
use crate::reconstruct::checkpoint::Checkpoint;
use crate::reconstruct::observed::Observed;

impl Trainer<'_> {
    /// The state before step `next`, with nothing in flight.
    pub(super) fn checkpoint(&self) -> Result<Checkpoint, ReconstructError> {
        let gaussians = &self.model.pass.gaussians;
        let count = gaussians.count;
        Ok(Checkpoint {
            fingerprint: self.fingerprint(),
            step: self.next,
            start_count: self.start_count as u32,
            sh_degree: gaussians.sh_degree,
            intersections: self.model.pass.buffers().sizes().intersections as u32,
            non_finite: self.optimizer.counters.read()?[0],
            seconds: self.seconds(),
            geometry: gaussians.geometry.read(count)?,
            geometry_moments: self.optimizer.geometry_moments.read(count)?,
            sh: gaussians.sh.read(count)?,
            sh_moments: self.optimizer.sh_moments.read(count)?,
            noise: self.noise.as_ref().map_or(Ok(Vec::new()), NoiseField::save)?,
            shake: self.model.save_kernels(),
            motions: self.model.save_motions(),
        })
    }

    pub(super) fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), ReconstructError> {
        if checkpoint.fingerprint != self.fingerprint() || checkpoint.step > self.config.steps {
            return Err(ReconstructError::OtherRound);
        }
        self.optimizer.geometry_moments.write(&checkpoint.geometry_moments)?;
        self.optimizer.sh_moments.write(&checkpoint.sh_moments)?;
        self.optimizer.counters.write(&[checkpoint.non_finite])?;
        if let Some(noise) = &mut self.noise {
            noise
                .restore(&checkpoint.noise)
                .map_err(|error| ReconstructError::Noise(error.to_string()))?;
        }
        self.start_count = checkpoint.start_count as usize;
        self.seconds_before = checkpoint.seconds;
        self.next = checkpoint.step;
        // The level before this step: `prepare` changes it at the same point as in an uninterrupted
        // round.
        let divisor = self.schedule.divisor(self.next.saturating_sub(1));
        self.set_level(divisor)?;
        self.model.restore_kernels(&checkpoint.shake)?;
        self.model.restore_motions(&checkpoint.motions)?;
        self.model.pass.set_room(checkpoint.intersections as usize)?;
        Ok(())
    }

    /// Hash of config and views.
    fn fingerprint(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("{:?}", self.config).as_bytes());
        for view in self.model.views.iter().map(Observed::given) {
            hasher.update(format!("{} {:?}", view.name, view.camera).as_bytes());
        }
        let hash = hasher.finalize();
        u64::from_le_bytes(*hash.as_bytes().first_chunk().expect("a hash has 32 bytes"))
    }
}
