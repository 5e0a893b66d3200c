//! Stable radix sort of u32 pairs on the GPU, 8 bits per pass; a GPU buffer holds the number of
//! pairs.
//!
//! A pass counts the digits of each block of keys, sums the counts over the blocks, and moves each
//! block. Blocks are independent, and a key's rank in its block follows from integer counts, so the
//! order depends on neither the device nor its subgroups.

use bytemuck::{Pod, Zeroable};
use fled_gpu::{Buffer, Gpu, GpuError, Kernel, Recorder, read, read_write, uniform};

/// Elements per block: BLOCK of shaders/shared/sort.wgsl.
pub const BLOCK: usize = 1024;
/// Bits of a digit.
const DIGIT_BITS: u32 = 8;
/// Values of a digit.
const DIGITS: usize = 1 << DIGIT_BITS;
/// `source` of [`SortParameters`] when the number of elements is `capacity` itself.
pub const FIXED: u32 = u32::MAX;

/// Exclusive prefix sum of a short array by one workgroup; writes a counter and indirect arguments.
pub const SCAN: Kernel = Kernel::new(
    "sort/scan",
    &[uniform("parameters"), read_write("counters"), read_write("values"), read_write("arguments")],
);
/// Digit counts of a block.
pub const RADIX_COUNT: Kernel = Kernel::new(
    "sort/radix_count",
    &[uniform("parameters"), read("counters"), read("keys"), read_write("histogram")],
);
/// Prefix sums of the counts of each digit over the blocks.
pub const RADIX_SCAN: Kernel = Kernel::new(
    "sort/radix_scan",
    &[uniform("parameters"), read("counters"), read_write("values"), read_write("totals")],
);
/// Moves the pairs of a block.
pub const RADIX_SCATTER: Kernel = Kernel::new(
    "sort/radix_scatter",
    &[
        uniform("parameters"),
        read("counters"),
        read("histogram"),
        read("totals"),
        read("keys"),
        read("payloads"),
        read_write("keys_out"),
        read_write("payloads_out"),
    ],
);

/// `SortParameters` of shaders/shared/sort.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SortParameters {
    /// First bit of the digit.
    pub shift: u32,
    /// Index of the counter with the number of elements; [`FIXED`] if `capacity` is the number.
    pub source: u32,
    /// Upper bound of the number of elements.
    pub capacity: u32,
    /// Index of the counter for the total of a scan.
    pub result: u32,
    /// Upper bound of the total in the indirect arguments.
    pub result_capacity: u32,
}

/// Counts that only the GPU knows, and the workgroups of the dispatches that depend on them.
///
/// Counter `i` has six arguments from `6 i` on: workgroups at one per block, then at one per 64
/// elements.
#[derive(Clone)]
pub struct Counters {
    /// The counts.
    pub values: Buffer<u32>,
    /// Indirect arguments, six per counter.
    pub arguments: Buffer<u32>,
}

impl Counters {
    /// `count` counters.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(gpu: &Gpu, count: usize) -> Result<Self, GpuError> {
        Ok(Self {
            values: gpu.create("counters", count)?,
            arguments: gpu.create("arguments", 6 * count)?,
        })
    }

    /// Index of the arguments of counter `index` at one workgroup per block.
    pub fn blocks(index: u32) -> usize {
        6 * index as usize
    }

    /// Index of the arguments of counter `index` at one invocation per element.
    pub fn elements(index: u32) -> usize {
        6 * index as usize + 3
    }
}

/// Buffers of a sort of at most `capacity` pairs.
///
/// The input is [`RadixSort::keys`] and [`RadixSort::payloads`], the output
/// [`RadixSort::sorted_keys`] and [`RadixSort::sorted_payloads`].
pub struct RadixSort {
    keys: [Buffer<u32>; 2],
    payloads: [Buffer<u32>; 2],
    histogram: Buffer<u32>,
    totals: Buffer<u32>,
    passes: Vec<Buffer<SortParameters>>,
    source: u32,
}

impl RadixSort {
    /// A sort by the lowest `bits` bits of as many pairs as counter `source` holds, at most
    /// `capacity`.
    ///
    /// # Errors
    /// Out of memory.
    pub fn new(gpu: &Gpu, capacity: usize, bits: u32, source: u32) -> Result<Self, GpuError> {
        let pass = |digit| {
            let parameters = SortParameters {
                shift: DIGIT_BITS * digit,
                source,
                capacity: capacity as u32,
                result: 0,
                result_capacity: 0,
            };
            gpu.upload("sort pass", &[parameters])
        };
        Ok(Self {
            keys: [gpu.create("sort keys", capacity)?, gpu.create("sort keys", capacity)?],
            payloads: [
                gpu.create("sort payloads", capacity)?,
                gpu.create("sort payloads", capacity)?,
            ],
            histogram: gpu.create("sort histogram", DIGITS * capacity.div_ceil(BLOCK))?,
            totals: gpu.create("sort totals", DIGITS)?,
            passes: (0..bits.div_ceil(DIGIT_BITS)).map(pass).collect::<Result<_, _>>()?,
            source,
        })
    }

    /// Keys to sort.
    pub fn keys(&self) -> &Buffer<u32> {
        &self.keys[0]
    }

    /// Payloads of the keys.
    pub fn payloads(&self) -> &Buffer<u32> {
        &self.payloads[0]
    }

    /// Keys in order.
    pub fn sorted_keys(&self) -> &Buffer<u32> {
        &self.keys[self.passes.len() % 2]
    }

    /// Payloads in the order of their keys; stable for equal keys.
    pub fn sorted_payloads(&self) -> &Buffer<u32> {
        &self.payloads[self.passes.len() % 2]
    }

    /// Records the sort. The arguments of the counter must have been written (by [`SCAN`]).
    ///
    /// # Errors
    /// A kernel error.
    pub fn record(&self, recorder: &mut Recorder, counters: &Counters) -> Result<(), GpuError> {
        let blocks = Counters::blocks(self.source);
        for (i, parameters) in self.passes.iter().enumerate() {
            let (from, to) = (i % 2, (i + 1) % 2);
            recorder.dispatch_indirect(
                &RADIX_COUNT,
                &[parameters, &counters.values, &self.keys[from], &self.histogram],
                &counters.arguments,
                blocks,
            )?;
            recorder.dispatch(
                &RADIX_SCAN,
                &[parameters, &counters.values, &self.histogram, &self.totals],
                [DIGITS as u32, 1, 1],
            )?;
            recorder.dispatch_indirect(
                &RADIX_SCATTER,
                &[
                    parameters,
                    &counters.values,
                    &self.histogram,
                    &self.totals,
                    &self.keys[from],
                    &self.payloads[from],
                    &self.keys[to],
                    &self.payloads[to],
                ],
                &counters.arguments,
                blocks,
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// Sorts on the GPU. A scan computes the number of keys there, as in a training step.
    fn sorted(keys: &[u32], bits: u32) -> (Vec<u32>, Vec<u32>) {
        let gpu = Gpu::new("auto").unwrap();
        let n = keys.len();
        let counters = Counters::new(&gpu, 1).unwrap();
        let sort = RadixSort::new(&gpu, n, bits, 0).unwrap();
        sort.keys().write(keys).unwrap();
        sort.payloads().write(&(0..n as u32).collect::<Vec<_>>()).unwrap();
        let total = gpu.upload("total", &[n as u32]).unwrap();
        let parameters = SortParameters {
            shift: 0,
            source: FIXED,
            capacity: 1,
            result: 0,
            result_capacity: n as u32,
        };
        let parameters = gpu.upload("parameters", &[parameters]).unwrap();
        let mut recorder = gpu.recorder();
        recorder
            .dispatch(
                &SCAN,
                &[&parameters, &counters.values, &total, &counters.arguments],
                [1, 1, 1],
            )
            .unwrap();
        sort.record(&mut recorder, &counters).unwrap();
        recorder.submit().unwrap();
        (sort.sorted_keys().read().unwrap(), sort.sorted_payloads().read().unwrap())
    }

    fn assert_sorted(keys: &[u32], bits: u32) {
        let mut expected: Vec<_> = (0..keys.len() as u32).collect();
        expected.sort_by_key(|&i| keys[i as usize]);
        let (found, payloads) = sorted(keys, bits);
        assert!(payloads == expected, "payloads of {} keys", keys.len());
        assert!(found.iter().zip(&expected).all(|(&k, &i)| k == keys[i as usize]));
    }

    #[test]
    fn random_keys_are_sorted_stably_at_sizes_around_a_block() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        for n in [2, 63, 1023, 1024, 1025, 5000, 70_001] {
            let keys: Vec<u32> = (0..n).map(|_| random.random()).collect();
            assert_sorted(&keys, 32);
        }
    }

    #[test]
    fn the_sort_is_stable_and_small_keys_need_few_bits() {
        assert_sorted(&[7; 3000], 32);
        let mut random = rand_pcg::Pcg64::seed_from_u64(2);
        let keys: Vec<u32> = (0..30_000).map(|_| random.random_range(0..180)).collect();
        assert_sorted(&keys, 8);
        assert_sorted(&keys, 12);
    }

    #[test]
    fn descending_single_and_no_keys_are_sorted() {
        assert_sorted(&(0..2500).rev().map(|i| i * 1_000_003).collect::<Vec<_>>(), 32);
        assert_sorted(&[u32::MAX], 32);
        assert_sorted(&[], 32);
    }

    #[test]
    #[should_panic(expected = "payloads")]
    fn the_comparison_fails_when_too_few_bits_are_sorted() {
        assert_sorted(&[256, 3, 512, 1], 8);
    }

    #[test]
    fn parameters_and_block_agree_with_the_shader() {
        let (_, found) = SCAN.reflect().unwrap();
        let structure = found.structure("SortParameters").unwrap();
        assert_eq!(structure.size as usize, size_of::<SortParameters>());
        assert_eq!(structure.members[4], ("result_capacity".to_owned(), 16));
        assert_eq!(found.constant("BLOCK"), Some(BLOCK as f64));
        assert_eq!(found.constant("DIGITS"), Some(DIGITS as f64));
        RADIX_COUNT.reflect().unwrap();
        RADIX_SCAN.reflect().unwrap();
        RADIX_SCATTER.reflect().unwrap();
    }
}
