//! The Gaussians on the device and their projection.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{
    Buffer, Gpu, GpuError, Kernel, Recorder, Rows, part_sizes, read, read_write, uniform,
};

use super::uniform::CameraUniform;
use crate::gaussians::Gaussians;

/// Floats of a row of `geometry`: mean, log-scale, quaternion w x y z, opacity logit, padding.
pub const GEOMETRY_ROW: usize = 12;

/// Projects every Gaussian and counts its tiles.
pub const PROJECT_FORWARD: Kernel = Kernel::new(
    "splat/project_forward",
    &[
        uniform("camera"),
        uniform("part"),
        read("geometry"),
        read("sh"),
        read_write("projected"),
        read_write("tile_counts"),
        read_write("depth_keys"),
    ],
);

/// `PartUniform` of shaders/shared/part.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct PartUniform {
    /// First Gaussian of the part.
    pub first: u32,
    /// Gaussians of the part.
    pub rows: u32,
    /// Unused.
    pub pad: [u32; 2],
}

/// Some of the Gaussians: as many as the adapter binds at once.
#[derive(Clone)]
pub struct Part {
    /// Which.
    pub uniform: Buffer<PartUniform>,
    /// How many.
    pub rows: usize,
}

/// Gaussians on the device with room for more.
#[derive(Clone)]
pub struct DeviceGaussians {
    /// [capacity, 12].
    pub geometry: Rows<f32>,
    /// [capacity, [`sh_row`]].
    pub sh: Rows<f32>,
    /// What a kernel is dispatched for, one after the other.
    pub parts: Vec<Part>,
    /// Rows that the buffers hold.
    pub capacity: usize,
    /// Rows in use.
    pub count: usize,
    /// Allocated degree of the harmonics.
    pub sh_degree: u32,
}

impl DeviceGaussians {
    /// Uploads `gaussians` into buffers for `capacity` rows, at least as many as there are.
    ///
    /// # Errors
    /// Out of memory, or above what the adapter binds.
    pub fn upload(gpu: &Gpu, gaussians: &Gaussians, capacity: usize) -> Result<Self, GpuError> {
        let capacity = capacity.max(gaussians.len());
        let row = sh_row(gaussians.sh_degree);
        // The longest rows of a Gaussian are Adam's two moments of its harmonics, or of its
        // geometry.
        let per_part = gpu.rows_per_part(2 * size_of::<f32>() * row.max(GEOMETRY_ROW));
        let mut parts = Vec::new();
        for rows in part_sizes(capacity, per_part) {
            let uniform = PartUniform {
                first: (parts.len() * per_part) as u32,
                rows: rows as u32,
                pad: [0; 2],
            };
            parts.push(Part {
                uniform: gpu.upload("part", &[uniform])?,
                rows,
            });
        }
        let out = Self {
            geometry: gpu.create_rows("geometry", capacity, GEOMETRY_ROW, per_part)?,
            sh: gpu.create_rows("sh", capacity, row, per_part)?,
            parts,
            capacity,
            count: gaussians.len(),
            sh_degree: gaussians.sh_degree,
        };
        out.geometry
            .write(pack_geometry(gaussians).as_flattened())?;
        out.sh.write(&pack_harmonics(gaussians))?;
        Ok(out)
    }

    /// Reads the Gaussians in use back.
    ///
    /// # Errors
    /// A device error.
    pub fn download(&self) -> Result<Gaussians, GpuError> {
        let (geometry, sh) = (self.geometry.read(self.count)?, self.sh.read(self.count)?);
        let (rows, _) = geometry.as_chunks::<GEOMETRY_ROW>();
        Ok(unpack_gaussians(rows, &sh, self.sh_degree))
    }
}

/// Floats of a row of harmonics: all coefficients of three channels, filled up to whole vectors of
/// four.
pub const fn sh_row(degree: u32) -> usize {
    (3 * (degree + 1) * (degree + 1)).next_multiple_of(4) as usize
}

/// Rows of `sh`.
fn pack_harmonics(gaussians: &Gaussians) -> Vec<f32> {
    let mut rows = vec![0.0; gaussians.len() * sh_row(gaussians.sh_degree)];
    let used = 3 * gaussians.coefficients();
    let sources = gaussians.sh.chunks_exact(used);
    for (row, source) in rows
        .chunks_exact_mut(sh_row(gaussians.sh_degree))
        .zip(sources)
    {
        row[..used].copy_from_slice(source);
    }
    rows
}

/// Rows of `geometry`.
pub fn pack_geometry(gaussians: &Gaussians) -> Vec<[f32; GEOMETRY_ROW]> {
    let row = |i: usize| {
        let ([x, y, z], [a, b, c]) = (gaussians.means[i], gaussians.log_scales[i]);
        let [qw, qx, qy, qz] = gaussians.quats[i];
        [
            x,
            y,
            z,
            a,
            b,
            c,
            qw,
            qx,
            qy,
            qz,
            gaussians.opacity_logits[i],
            0.0,
        ]
    };
    (0..gaussians.len()).map(row).collect()
}

/// Gaussians from rows of geometry and of harmonics.
pub fn unpack_gaussians(rows: &[[f32; GEOMETRY_ROW]], sh: &[f32], sh_degree: u32) -> Gaussians {
    let used = 3 * ((sh_degree + 1) * (sh_degree + 1)) as usize;
    let sh = sh
        .chunks_exact(sh_row(sh_degree))
        .flat_map(|row| &row[..used])
        .copied()
        .collect();
    Gaussians {
        means: rows.iter().map(|r| [r[0], r[1], r[2]]).collect(),
        log_scales: rows.iter().map(|r| [r[3], r[4], r[5]]).collect(),
        quats: rows.iter().map(|r| [r[6], r[7], r[8], r[9]]).collect(),
        opacity_logits: rows.iter().map(|r| r[10]).collect(),
        sh,
        sh_degree,
    }
}

/// What the projection writes, by Gaussian.
#[derive(Clone)]
pub struct Projection {
    /// The camera; written before each use.
    pub camera: Buffer<CameraUniform>,
    /// [capacity, 3]: mean xy, conic ab | conic c, opacity, red, green | blue, depth, extent xy.
    /// Stale where `tile_counts` is 0.
    pub projected: Buffer<[f32; 4]>,
    /// Tiles touched; 0 is culled, [capacity].
    pub tile_counts: Buffer<u32>,
    /// Bits of the depth; all ones when culled, [capacity].
    pub depth_keys: Buffer<u32>,
}

impl Projection {
    /// Buffers for `capacity` Gaussians.
    ///
    /// # Errors
    /// Out of memory, or above what the adapter binds.
    pub fn new(gpu: &Gpu, capacity: usize) -> Result<Self, GpuError> {
        Ok(Self {
            camera: gpu.create("camera", 1)?,
            projected: gpu.create("projected", 3 * capacity)?,
            tile_counts: gpu.create("tile counts", capacity)?,
            depth_keys: gpu.create("depth keys", capacity)?,
        })
    }

    /// Adds the projection of every row of `gaussians`; the kernel stops at the camera's count.
    ///
    /// # Errors
    /// A shader or binding error.
    pub fn record(
        &self,
        recorder: &mut Recorder,
        gaussians: &DeviceGaussians,
    ) -> Result<(), GpuError> {
        for ((part, geometry), sh) in gaussians
            .parts
            .iter()
            .zip(gaussians.geometry.parts())
            .zip(gaussians.sh.parts())
        {
            recorder.dispatch_items(
                &PROJECT_FORWARD,
                &[
                    &self.camera,
                    &part.uniform,
                    geometry,
                    sh,
                    &self.projected,
                    &self.tile_counts,
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
    use crate::splat::fixtures::{self, relative_l2};
    use crate::splat::reference::{Projected, Splat, project};

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
            projection.tile_counts.read(),
            projection.depth_keys.read(),
        );
        (
            read.0.expect("read"),
            read.1.expect("read"),
            read.2.expect("read"),
        )
    }

    fn flat(p: &Projected) -> [f64; 12] {
        let ([x, y], [a, b, c], [red, green, blue]) = (p.mean, p.conic, p.colour);
        [
            x,
            y,
            a,
            b,
            c,
            p.opacity,
            red,
            green,
            blue,
            p.depth,
            p.extent[0],
            p.extent[1],
        ]
    }

    /// Tiles that hold a pixel which blending would touch, by looking at every pixel.
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
    fn the_projection_equals_the_reference_and_loses_no_tile() {
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
            assert!(
                counts[i] as usize >= brute,
                "{i} lost {brute} - {}",
                counts[i]
            );
            (counted, needed) = (counted + counts[i] as usize, needed + brute);
            if counts[i] == 0 {
                continue;
            }
            visible += 1;
            let row: Vec<_> = projected[3 * i..3 * i + 3]
                .iter()
                .flatten()
                .map(|v| f64::from(*v))
                .collect();
            assert_eq!(keys[i], (row[9] as f32).to_bits());
            for (value, expected) in row.iter().zip(flat(&expected)) {
                assert!(
                    (value - expected).abs() <= 2e-4 * (1.0 + expected.abs()),
                    "{i}: {row:?} {expected}"
                );
            }
        }
        assert!(visible > 150, "{visible} visible");
        // A tile may be counted for a position between its pixel centres: the test is over the box
        // of centres.
        assert!(
            counted as f64 <= 1.1 * needed as f64,
            "{counted} counted, {needed} needed"
        );
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
        let (_, counts, keys) = run(
            &gaussians,
            &CameraUniform::new(&view.camera, 7, 1, 1, view.near as f32),
        );
        assert_eq!(counts[..6], [0; 6]);
        assert_eq!(keys[..6], [u32::MAX; 6]);
        assert!(counts[6] > 0);
    }

    #[test]
    fn a_share_of_the_gaussians_is_dropped_and_the_others_make_up_for_it() {
        let gaussians = fixtures::gaussians(2_000, 0, 8);
        let view = fixtures::viewpoint(96, 64);
        let whole = CameraUniform::new(&view.camera, 2_000, 0, 0, view.near as f32);
        let (rows, counts, _) = run(&gaussians, &whole);
        let visible: Vec<usize> = (0..2_000).filter(|&i| counts[i] > 0).collect();
        let dropped = |draw: u32| {
            let (fewer, counts, _) = run(&gaussians, &whole.dropping(0.2, draw));
            for &i in visible.iter().filter(|&&i| counts[i] > 0) {
                let (before, after) = (rows[3 * i + 1][1], fewer[3 * i + 1][1]);
                assert!((after - before / 0.8).abs() < 1e-6, "{before} {after}");
            }
            visible
                .iter()
                .filter(|&&i| counts[i] == 0)
                .copied()
                .collect::<Vec<_>>()
        };
        let (one, other) = (dropped(1), dropped(2));
        let share = one.len() as f64 / visible.len() as f64;
        assert!((share - 0.2).abs() < 0.04 && one != other, "{share}");
        assert_eq!(one, dropped(1));
    }

    #[test]
    fn gaussians_survive_the_device_bit_for_bit() {
        let gaussians = fixtures::gaussians(33, 2, 8);
        let device = DeviceGaussians::upload(fixtures::gpu(), &gaussians, 50).expect("uploaded");
        assert_eq!(device.download().expect("read"), gaussians);
    }

    #[test]
    fn the_part_has_the_layout_of_the_shader() {
        let (_, found) = PROJECT_FORWARD.reflect().expect("valid");
        let part = found.structure("PartUniform").expect("declared");
        let offset = |name: &str| {
            part.members
                .iter()
                .find(|m| m.0 == name)
                .map(|m| m.1 as usize)
        };
        assert_eq!(part.size as usize, size_of::<PartUniform>());
        assert_eq!(
            offset("first"),
            Some(std::mem::offset_of!(PartUniform, first))
        );
        assert_eq!(
            offset("rows"),
            Some(std::mem::offset_of!(PartUniform, rows))
        );
    }

    #[test]
    fn the_camera_has_the_layout_of_the_shader() {
        let (_, found) = PROJECT_FORWARD.reflect().expect("valid");
        let camera = found
            .structs
            .iter()
            .find(|s| s.name == "CameraUniform")
            .expect("declared");
        let offsets: Vec<_> = camera
            .members
            .iter()
            .map(|(name, at)| (name.as_str(), *at as usize))
            .collect();
        let expected = [
            ("row_x", std::mem::offset_of!(CameraUniform, row_x)),
            ("row_y", std::mem::offset_of!(CameraUniform, row_y)),
            ("row_z", std::mem::offset_of!(CameraUniform, row_z)),
            ("focal", std::mem::offset_of!(CameraUniform, focal)),
            ("centre", std::mem::offset_of!(CameraUniform, centre)),
            ("size", std::mem::offset_of!(CameraUniform, size)),
            ("tiles", std::mem::offset_of!(CameraUniform, tiles)),
            ("position", std::mem::offset_of!(CameraUniform, position)),
            ("draw", std::mem::offset_of!(CameraUniform, draw)),
            ("sh_degree", std::mem::offset_of!(CameraUniform, sh_degree)),
            ("count", std::mem::offset_of!(CameraUniform, count)),
            ("near", std::mem::offset_of!(CameraUniform, near)),
            ("sh_row", std::mem::offset_of!(CameraUniform, sh_row)),
            (
                "background",
                std::mem::offset_of!(CameraUniform, background),
            ),
            ("dropout", std::mem::offset_of!(CameraUniform, dropout)),
        ];
        assert_eq!(offsets, expected);
    }
}
