//! The state of a round as numbers, and back.

use super::Trainer;
use crate::gaussians::Gaussians;
use crate::noise::NoiseField;
use crate::reconstruct::ReconstructError;
use crate::reconstruct::checkpoint::Checkpoint;
use crate::reconstruct::level::Level;
use crate::shake::Shake;
use crate::splat::project::{GEOMETRY_ROW, unpack_gaussians};
use crate::splat::rasterize::{SplatBuffers, SplatSizes};

impl Trainer<'_> {
    /// The state before the step `next`, with nothing in flight.
    pub(super) fn checkpoint(&self) -> Result<Checkpoint, ReconstructError> {
        let count = self.gaussians.count;
        Ok(Checkpoint {
            fingerprint: self.fingerprint(),
            step: self.next,
            start_count: self.start_count as u32,
            sh_degree: self.gaussians.sh_degree,
            intersections: self.raster.sizes().intersections as u32,
            non_finite: self.optimizer.counters.read()?[0],
            geometry: self.gaussians.geometry.read(count)?,
            geometry_moments: self.optimizer.geometry_moments.read(count)?,
            sh: self.gaussians.sh.read(count)?,
            sh_moments: self.optimizer.sh_moments.read(count)?,
            noise: self
                .noise
                .as_ref()
                .map_or(Ok(Vec::new()), NoiseField::save)?,
            shake: self.shake.as_ref().map_or(Vec::new(), Shake::save),
            motions: self
                .motions
                .iter()
                .flat_map(|motion| motion.twist)
                .collect(),
            colours: self
                .colours
                .iter()
                .flat_map(|colour| colour.to_row())
                .collect(),
        })
    }

    pub(super) fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), ReconstructError> {
        if checkpoint.fingerprint != self.fingerprint() || checkpoint.step > self.config.steps {
            return Err(ReconstructError::OtherRound);
        }
        self.optimizer
            .geometry_moments
            .write(&checkpoint.geometry_moments)?;
        self.optimizer.sh_moments.write(&checkpoint.sh_moments)?;
        self.optimizer.counters.write(&[checkpoint.non_finite])?;
        if let Some(noise) = &mut self.noise {
            noise
                .restore(&checkpoint.noise)
                .map_err(|error| ReconstructError::Noise(error.to_string()))?;
        }
        self.start_count = checkpoint.start_count as usize;
        self.next = checkpoint.step;
        // The level in use before this step: `prepare` changes it where the undisturbed round does.
        let divisor = self.schedule.divisor(self.next.saturating_sub(1));
        self.level = Level::new(self.gpu, self.views, divisor)?;
        self.restore_shake(&checkpoint.shake)?;
        self.restore_motions(&checkpoint.motions)?;
        self.restore_colours(&checkpoint.colours)?;
        let sizes = self.raster.sizes();
        let intersections = checkpoint.intersections as usize;
        self.raster = SplatBuffers::new(
            self.gpu,
            SplatSizes {
                intersections,
                ..sizes
            },
            true,
        )?;
        Ok(())
    }

    /// Identifies config and views.
    fn fingerprint(&self) -> u64 {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("{:?}", self.config).as_bytes());
        for view in self.views {
            hasher.update(format!("{} {:?}", view.name, view.camera).as_bytes());
        }
        let hash = hasher.finalize();
        u64::from_le_bytes(*hash.as_bytes().first_chunk().expect("a hash has 32 bytes"))
    }
}

/// The Gaussians of a checkpoint.
pub(super) fn scene_of(checkpoint: &Checkpoint) -> Gaussians {
    let (rows, _) = checkpoint.geometry.as_chunks::<GEOMETRY_ROW>();
    unpack_gaussians(rows, &checkpoint.sh, checkpoint.sh_degree)
}
