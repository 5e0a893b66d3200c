//! Projection of the Gaussians on the device.

use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, read, read_write, uniform};

use super::rows::DeviceGaussians;
use super::uniform::CameraUniform;

/// Projects every Gaussian and counts its tiles.
pub const PROJECT_FORWARD: Kernel = Kernel::new(
    "splat/project_forward",
    &[
        uniform("camera"),
        uniform("part"),
        read("geometry"),
        read("sh"),
        read_write("projected"),
        read_write("spans"),
        read_write("depth_keys"),
    ],
);

/// The output of the projection, by Gaussian.
#[derive(Clone)]
pub struct Projection {
    /// The camera; written before each use.
    pub camera: Buffer<CameraUniform>,
    /// [capacity, 3]: mean xy, conic ab | conic c, opacity, red, green | blue, depth, extent xy.
    /// Stale where a Gaussian touches no tile.
    pub projected: Buffer<[f32; 4]>,
    /// [1 + capacity]: first slot (undefined if culled), number of tiles touched (0 if culled). The
    /// first row: the exact number of intersections of the last image, and the number of gradients
    /// that training dropped. One buffer for all four keeps the optimiser's bindings at eight.
    pub spans: Buffer<[u32; 2]>,
    /// Bits of the depth, all ones if culled, [capacity].
    pub depth_keys: Buffer<u32>,
}

impl Projection {
    /// Buffers for `capacity` Gaussians.
    ///
    /// # Errors
    /// Out of memory, or more than the adapter can bind.
    pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self, GpuError> {
        Ok(Self {
            camera: gpu.create("camera", 1)?,
            projected: gpu.create("projected", 3 * capacity)?,
            spans: gpu.create("spans", 1 + capacity)?,
            depth_keys: gpu.create("depth keys", capacity)?,
        })
    }

    /// Number of gradients that training dropped.
    ///
    /// # Errors
    /// A device error.
    pub fn dropped(&self) -> Result<u32, GpuError> {
        Ok(self.spans.start_read(1)?.wait()?[0][1])
    }

    /// Sets the number of gradients that training dropped.
    ///
    /// # Errors
    /// A device error.
    pub fn set_dropped(&self, dropped: u32) -> Result<(), GpuError> {
        self.spans.write(&[[0, dropped]])
    }

    /// The numbers of tiles that the first `count` Gaussians touch.
    ///
    /// # Errors
    /// A device error.
    #[cfg(test)]
    pub(crate) fn tile_counts(&self, count: usize) -> Result<Vec<u32>, GpuError> {
        Ok(self.spans.start_read(1 + count)?.wait()?[1..].iter().map(|span| span[1]).collect())
    }

    /// Records the projection of every row of `gaussians`; the kernel stops at the camera's count.
    ///
    /// # Errors
    /// A shader or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
    ) -> Result<(), GpuError> {
        for ((part, geometry), sh) in
            gaussians.parts.iter().zip(gaussians.geometry.parts()).zip(gaussians.sh.parts())
        {
            recorder.dispatch_items(
                &PROJECT_FORWARD,
                &[
                    &self.camera,
                    &part.uniform,
                    geometry,
                    sh,
                    &self.projected,
                    &self.spans,
                    &self.depth_keys,
                ],
                part.rows,
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::Gaussians;
    use crate::splat::fixtures::{self, relative_l2};
    use crate::splat::reference::{Projected, Splat, project};
    use crate::splat::rows::PartUniform;

    fn run(gaussians: &Gaussians, camera: &CameraUniform) -> (Vec<[f32; 4]>, Vec<u32>, Vec<u32>) {
        let gpu = fixtures::gpu();
        let device = DeviceGaussians::upload(gpu, gaussians, 0).expect("uploaded");
        let projection = Projection::new(gpu, gaussians.len()).expect("created");
        projection.camera.write(&[*camera]).expect("written");
        let mut recorder = gpu.recorder();
        projection.record(&mut recorder, &device).expect("recorded");
        recorder.submit().expect("submitted");
        let read = (
            projection.projected.read(),
            projection.tile_counts(gaussians.len()),
            projection.depth_keys.read(),
        );
        (read.0.expect("read"), read.1.expect("read"), read.2.expect("read"))
    }

    fn flat(p: &Projected) -> [f64; 12] {
        let ([x, y], [a, b, c], [red, green, blue]) = (p.mean, p.conic, p.colour);
        [x, y, a, b, c, p.opacity, red, green, blue, p.depth, p.extent[0], p.extent[1]]
    }

    /// Number of tiles with a pixel that blending would touch, by testing every pixel.
    fn tiles_by_brute_force(p: &Projected, width: usize, height: usize) -> usize {
        let mut tiles = std::collections::HashSet::new();
        for pixel in 0..width * height {
            let (x, y) = (pixel % width, pixel / width);
            let (dx, dy) = (x as f64 + 0.5 - p.mean[0], y as f64 + 0.5 - p.mean[1]);
            let [a, b, c] = p.conic;
            let exponent = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy;
            if p.opacity * (-exponent).exp() >= 1.0 / 255.0 {
                tiles.insert((x / 16, y / 16));
            }
        }
        tiles.len()
    }

    #[test]
    fn the_projection_matches_the_reference_and_misses_no_tile() {
        let view = fixtures::viewpoint(144, 96);
        let gaussians = fixtures::gaussians(400, 3, 17);
        let camera = CameraUniform::new(&view.camera, 400, 3, 3, view.near as f32);
        let (projected, counts, keys) = run(&gaussians, &camera);
        let (mut visible, mut counted, mut needed) = (0, 0, 0);
        for i in 0..gaussians.len() {
            let Some(expected) = project(&Splat::from_gaussians(&gaussians, i), &view) else {
                assert_eq!((counts[i], keys[i]), (0, u32::MAX), "{i} is culled");
                continue;
            };
            let brute = tiles_by_brute_force(&expected, 144, 96);
            assert!(counts[i] as usize >= brute, "{i} lost {brute} - {}", counts[i]);
            (counted, needed) = (counted + counts[i] as usize, needed + brute);
            if counts[i] == 0 {
                continue;
            }
            visible += 1;
            let found = fixtures::projected(&projected, i);
            assert_eq!(keys[i], (found.depth as f32).to_bits());
            for (value, expected) in flat(&found).into_iter().zip(flat(&expected)) {
                assert!(
                    (value - expected).abs() <= 2e-4 * (1.0 + expected.abs()),
                    "{i}: {found:?} {expected}"
                );
            }
        }
        assert!(visible > 150, "{visible} visible");
        // A tile may be counted for a position between its pixel centres: the test is over the box
        // of centres.
        assert!(counted as f64 <= 1.1 * needed as f64, "{counted} counted, {needed} needed");
        assert!(relative_l2(&[1.0, 2.0], &[1.0, 2.5]) > 0.1);
    }

    #[test]
    fn poisoned_gaussians_are_culled_on_the_device() {
        let mut gaussians = fixtures::gaussians(7, 1, 3);
        gaussians.means.fill([0.0; 3]);
        gaussians.log_scales.fill([-2.0; 3]);
        gaussians.opacity_logits.fill(2.0);
        gaussians.means[0][1] = f32::NAN;
        gaussians.quats[1] = [0.0; 4];
        gaussians.log_scales[2] = [3e38; 3];
        gaussians.sh[3 * 12 + 1] = f32::INFINITY;
        gaussians.opacity_logits[4] = f32::NAN;
        gaussians.means[5] = [0.0, 0.0, -50.0];
        let view = fixtures::viewpoint(64, 48);
        let (_, counts, keys) =
            run(&gaussians, &CameraUniform::new(&view.camera, 7, 1, 1, view.near as f32));
        assert_eq!(counts[..6], [0; 6]);
        assert_eq!(keys[..6], [u32::MAX; 6]);
        assert!(counts[6] > 0);
    }

    #[test]
    fn gaussians_round_trip_bit_for_bit() {
        let gaussians = fixtures::gaussians(33, 2, 8);
        let device = DeviceGaussians::upload(fixtures::gpu(), &gaussians, 50).expect("uploaded");
        assert_eq!(device.download().expect("read"), gaussians);
    }

    #[test]
    fn the_part_uniform_has_the_shaders_layout() {
        let (_, found) = PROJECT_FORWARD.reflect().expect("valid");
        let part = found.structure("PartUniform").expect("declared");
        let offset = |name: &str| part.members.iter().find(|m| m.0 == name).map(|m| m.1 as usize);
        assert_eq!(part.size as usize, size_of::<PartUniform>());
        assert_eq!(offset("first"), Some(std::mem::offset_of!(PartUniform, first)));
        assert_eq!(offset("rows"), Some(std::mem::offset_of!(PartUniform, rows)));
    }

    #[test]
    fn the_camera_uniform_has_the_shaders_layout() {
        let (_, found) = PROJECT_FORWARD.reflect().expect("valid");
        let camera = found.structs.iter().find(|s| s.name == "CameraUniform").expect("declared");
        let offsets: Vec<_> =
            camera.members.iter().map(|(name, at)| (name.as_str(), *at as usize)).collect();
        let expected = [
            ("row_x", std::mem::offset_of!(CameraUniform, row_x)),
            ("row_y", std::mem::offset_of!(CameraUniform, row_y)),
            ("row_z", std::mem::offset_of!(CameraUniform, row_z)),
            ("focal", std::mem::offset_of!(CameraUniform, focal)),
            ("centre", std::mem::offset_of!(CameraUniform, centre)),
            ("size", std::mem::offset_of!(CameraUniform, size)),
            ("tiles", std::mem::offset_of!(CameraUniform, tiles)),
            ("position", std::mem::offset_of!(CameraUniform, position)),
            ("sh_degree", std::mem::offset_of!(CameraUniform, sh_degree)),
            ("background", std::mem::offset_of!(CameraUniform, background)),
            ("count", std::mem::offset_of!(CameraUniform, count)),
            ("near", std::mem::offset_of!(CameraUniform, near)),
            ("sh_row", std::mem::offset_of!(CameraUniform, sh_row)),
        ];
        assert_eq!(offsets, expected);
    }
}
