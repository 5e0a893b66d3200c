//! How much a submission had to do, for whoever relates its time to it.

use fled_gpu::GpuError;

use super::SplatBuffers;
use crate::splat::uniform::TILE;

/// What one image asked of the rasteriser.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplatWork {
    /// Gaussians that touch a tile.
    pub visible: usize,
    /// Pairs of a splat and a tile it touches, cut to what the buffers hold.
    pub intersections: usize,
    /// Tiles that the buffers hold.
    pub tiles: usize,
    /// Pairs of an intersection and a half of its tile that blending came to before every pixel had
    /// stopped: of that half, or of the tile, as the kernel has it.
    pub walked: usize,
    /// Passes of the sort by depth and of the sort by tile.
    pub passes: [usize; 2],
}

impl SplatWork {
    /// Pairs of a pixel and a splat that blending came to, pixels outside of the image among them.
    /// A kernel that passes over halves that a splat does not touch evaluates fewer.
    pub fn pairs(&self) -> usize {
        self.walked * (TILE * TILE / 2) as usize
    }
}

impl SplatBuffers {
    /// The work of the last submission, of an image of the size that the buffers were made for.
    /// Waits.
    ///
    /// # Errors
    /// A device error.
    pub fn work(&self) -> Result<SplatWork, GpuError> {
        let tiles = self.sizes.tiles();
        let (counts, ranges) = (self.counts()?, self.tile_ranges.start_read(tiles)?);
        let last = self.last.start_read(2 * tiles)?.wait()?;
        let (counts, ranges) = (counts.wait()?, ranges.wait()?);
        // A tile that nothing touches keeps where its range begins.
        let walked = ranges
            .iter()
            .zip(last.chunks(2))
            .flat_map(|(range, ends)| ends.iter().map(|end| end.saturating_sub(range[0]) as usize));
        Ok(SplatWork {
            visible: counts.visible,
            intersections: counts.intersections.min(counts.capacity),
            tiles,
            walked: walked.sum(),
            passes: [self.depth.passes(), self.tile.passes()],
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::splat::fixtures;
    use crate::splat::project::Projection;
    use crate::splat::rasterize::{Forward, Specialisation, SplatBuffers, SplatSizes};
    use crate::splat::rows::DeviceGaussians;
    use crate::splat::uniform::CameraUniform;

    #[test]
    fn a_splat_in_the_middle_of_a_tile_is_walked_once_and_one_behind_the_camera_is_not() {
        let gpu = fixtures::gpu();
        let mut view = fixtures::viewpoint(64, 48).camera;
        // The origin falls into the middle of the second tile of the second row.
        (view.intrinsics.cx, view.intrinsics.cy) = (24.0, 24.0);
        let mut gaussians = fixtures::gaussians(2, 0, 1);
        gaussians.means = vec![[0.0; 3], [0.0, 0.0, -50.0]];
        gaussians.log_scales.fill([-6.0; 3]);
        gaussians.opacity_logits.fill(2.0);
        let device = DeviceGaussians::upload(gpu, &gaussians, 0).unwrap();
        let projection = Projection::new(gpu, 2).unwrap();
        let sizes = SplatSizes {
            gaussians: 2,
            width: 64,
            height: 48,
            intersections: 100,
        };
        let buffers = SplatBuffers::new(gpu, sizes, false).unwrap();
        projection
            .camera
            .write(&[CameraUniform::new(&view, 2, 0, 0, 0.1)])
            .unwrap();
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).unwrap();
        let forward = Forward::new(Specialisation::for_adapter(gpu.describe()));
        forward
            .record(&mut recorder, &projection, &buffers)
            .unwrap();
        recorder.submit().unwrap();
        let work = buffers.work().unwrap();
        assert_eq!((work.visible, work.intersections, work.tiles), (1, 1, 12));
        assert_eq!((work.walked, work.pairs()), (2, 256));
        // 12 tiles and the one of what belongs to none: 4 bits.
        assert_eq!(work.passes, [8, 1]);
    }
}
