//! The frozen state of a training round: all that is needed to resume as if uninterrupted.

use bytemuck::{Pod, Zeroable};

use super::training::TrainingState;

/// First bytes of a checkpoint.
const MAGIC: [u8; 8] = *b"fledckpt";
/// Raised whenever the layout or the meaning changes.
const VERSION: u32 = 11;

/// Number of arrays in a checkpoint.
const ARRAYS: usize = 7;
/// Bytes of the hash at the end.
const HASH: usize = 32;

/// The bytes are not a checkpoint of this version, or belong to other inputs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("checkpoint: {0}")]
pub struct CheckpointError(pub String);

/// The state of a round before step `step`. Random numbers are functions of seed and step, so there
/// is no generator state.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint {
    /// Identifies the plan: seed, steps and the options of the round.
    pub fingerprint: u64,
    /// Next step, 0-based.
    pub step: u32,
    /// Steps of the round: others than planned once the time limit changed them.
    pub steps: u32,
    /// Gaussians at the start of the round.
    pub start_count: u32,
    /// Most Gaussians: fewer than asked for once the device ran out of memory.
    pub cap: u64,
    /// Wall seconds taken so far.
    pub seconds: f64,
    /// The scene in training.
    pub state: TrainingState,
    /// The views' serialised kernels; empty without shake.
    pub shake: Vec<f32>,
    /// The views' motions, [views, 6].
    pub motions: Vec<f32>,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Header {
    magic: [u8; 8],
    fingerprint: u64,
    version: u32,
    step: u32,
    start_count: u32,
    sh_degree: u32,
    intersections: u32,
    non_finite: u32,
    cap: u64,
    steps: u64,
    seconds: f64,
    lengths: [u64; ARRAYS],
    stamp: [u8; HASH],
}

impl Checkpoint {
    /// The checkpoint as bytes: a header, then the arrays, little endian. `inputs` identifies all
    /// that the round depends on. It lies in the header, so that no kill leaves one without the
    /// other.
    pub fn to_bytes(&self, inputs: &str) -> Vec<u8> {
        let arrays = self.arrays();
        let header = Header {
            magic: MAGIC,
            fingerprint: self.fingerprint,
            version: VERSION,
            step: self.step,
            start_count: self.start_count,
            sh_degree: self.state.sh_degree,
            intersections: self.state.intersections,
            non_finite: self.state.non_finite,
            cap: self.cap,
            steps: u64::from(self.steps),
            seconds: self.seconds,
            lengths: arrays.map(|a| a.len() as u64),
            stamp: stamp(inputs),
        };
        let mut bytes = bytemuck::bytes_of(&header).to_vec();
        for array in arrays {
            bytes.extend_from_slice(bytemuck::cast_slice(array));
        }
        let hash = blake3::hash(&bytes);
        bytes.extend_from_slice(hash.as_bytes());
        bytes
    }

    fn arrays(&self) -> [&[f32]; ARRAYS] {
        [
            &self.state.geometry,
            &self.state.geometry_moments,
            &self.state.sh,
            &self.state.sh_moments,
            &self.state.noise,
            &self.shake,
            &self.motions,
        ]
    }

    /// The inverse of [`Checkpoint::to_bytes`].
    ///
    /// # Errors
    /// [`CheckpointError`] for bytes that are truncated, changed, of another version, or of other
    /// inputs.
    pub fn from_bytes(bytes: &[u8], inputs: &str) -> Result<Self, CheckpointError> {
        let content = intact(bytes)?;
        let (header, rest) = content.split_at(size_of::<Header>());
        let header: Header = bytemuck::pod_read_unaligned(header);
        if header.stamp != stamp(inputs) {
            return Err(fault("of another round, other options or another build"));
        }
        let [geometry, geometry_moments, sh, sh_moments, noise, shake, motions] =
            arrays(rest, &header.lengths)?;
        let state = TrainingState {
            sh_degree: header.sh_degree,
            intersections: header.intersections,
            non_finite: header.non_finite,
            geometry,
            geometry_moments,
            sh,
            sh_moments,
            noise,
        };
        if !state.is_consistent() {
            return Err(fault("its arrays do not match"));
        }
        Ok(Self {
            fingerprint: header.fingerprint,
            step: header.step,
            steps: header.steps as u32,
            start_count: header.start_count,
            cap: header.cap,
            seconds: header.seconds,
            state,
            shake,
            motions,
        })
    }
}

fn stamp(inputs: &str) -> [u8; HASH] {
    *blake3::hash(inputs.as_bytes()).as_bytes()
}

fn fault(message: &str) -> CheckpointError {
    CheckpointError(message.to_owned())
}

/// Returns header and arrays if version and hash are right.
fn intact(bytes: &[u8]) -> Result<&[u8], CheckpointError> {
    let (content, hash) = bytes
        .split_last_chunk::<HASH>()
        .filter(|(content, _)| content.len() >= size_of::<Header>())
        .ok_or_else(|| fault("too short"))?;
    let header: Header = bytemuck::pod_read_unaligned(&content[..size_of::<Header>()]);
    if header.magic != MAGIC {
        return Err(fault("not a checkpoint"));
    }
    if header.version != VERSION {
        let found = header.version;
        return Err(fault(&format!("version {found}, but this program reads {VERSION}")));
    }
    if blake3::hash(content).as_bytes() != hash {
        return Err(fault("damaged"));
    }
    Ok(content)
}

/// Splits the bytes into arrays of these lengths.
fn arrays(bytes: &[u8], lengths: &[u64; ARRAYS]) -> Result<[Vec<f32>; ARRAYS], CheckpointError> {
    let mut rest = bytes;
    let mut arrays = [const { Vec::new() }; ARRAYS];
    for (array, &length) in arrays.iter_mut().zip(lengths) {
        let size = usize::try_from(length)
            .ok()
            .and_then(|numbers| numbers.checked_mul(size_of::<f32>()))
            .unwrap_or(usize::MAX);
        let (values, tail) = rest.split_at_checked(size).ok_or_else(|| fault("truncated"))?;
        *array = bytemuck::pod_collect_to_vec(values);
        rest = tail;
    }
    Ok(arrays)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkpoint() -> Checkpoint {
        let ramp = |n: usize| (0..n).map(|i| i as f32 * 0.5 - 3.0).collect::<Vec<_>>();
        Checkpoint {
            fingerprint: 77,
            step: 120,
            steps: 200,
            start_count: 2,
            cap: 3,
            seconds: 7.5,
            state: TrainingState {
                sh_degree: 1,
                intersections: 4_000,
                non_finite: 1,
                geometry: ramp(36),
                geometry_moments: ramp(72),
                sh: ramp(36),
                sh_moments: ramp(72),
                noise: ramp(5),
            },
            shake: ramp(4),
            motions: ramp(12),
        }
    }

    #[test]
    fn a_checkpoint_round_trips_bit_for_bit() {
        assert_eq!(
            Checkpoint::from_bytes(&checkpoint().to_bytes("round 1"), "round 1"),
            Ok(checkpoint())
        );
    }

    #[test]
    fn a_truncated_damaged_or_foreign_checkpoint_is_refused() {
        let bytes = checkpoint().to_bytes("round 1");
        let refused =
            |bytes: &[u8]| Checkpoint::from_bytes(bytes, "round 1").expect_err("refused").0;
        assert_eq!(refused(&bytes[..20]), "too short");
        assert_eq!(refused(&bytes[..bytes.len() - 4]), "damaged");
        let mut changed = bytes.clone();
        changed[200] ^= 1;
        assert_eq!(refused(&changed), "damaged");
        let mut newer = bytes.clone();
        newer[16] += 1;
        assert!(refused(&newer).starts_with("version 12"));
        assert_eq!(refused(&[0; 200]), "not a checkpoint");
        let mut odd = checkpoint();
        odd.state.sh_degree = 2;
        assert_eq!(refused(&odd.to_bytes("round 1")), "its arrays do not match");
        let foreign = checkpoint().to_bytes("round 2");
        assert_eq!(refused(&foreign), "of another round, other options or another build");
    }
}
