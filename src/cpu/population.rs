//! The Gaussians with their optimiser's state, sixteen to a block: each block holds a vector of
//! every number, so that a kernel reads and writes in one stream.

use crate::simd::{LANES, Lanes};

/// Numbers of a Gaussian before its harmonics.
pub const GEOMETRY: usize = 11;

/// First columns of a Gaussian's numbers: mean, log-scale, quaternion w x y z, opacity logit,
/// harmonics (coefficient by coefficient, red green blue).
pub mod column {
    /// World units.
    pub const MEAN: usize = 0;
    /// Natural logarithm of world units.
    pub const LOG_SCALE: usize = 3;
    /// w x y z, not necessarily normalised.
    pub const QUAT: usize = 6;
    /// Before the sigmoid.
    pub const LOGIT: usize = 10;
    /// First coefficient.
    pub const HARMONICS: usize = super::GEOMETRY;
}

/// Gaussians and, in training, Adam's moments.
#[derive(Clone, Debug, PartialEq)]
pub struct Population {
    pub(crate) sh_degree: u32,
    pub(crate) count: usize,
    /// [blocks, columns].
    /// Whether there are moments and statistics.
    trains: bool,
    pub(crate) values: Vec<Lanes>,
    pub(crate) first: Vec<Lanes>,
    pub(crate) second: Vec<Lanes>,
    /// Sums of the lengths of the gradients by position, and numbers of views in them, [blocks].
    pub(crate) seen: Vec<[Lanes; 2]>,
}

/// Position of a number of a Gaussian.
fn place(columns: usize, gaussian: usize, column: usize) -> (usize, usize) {
    (gaussian / LANES * columns + column, gaussian % LANES)
}

impl Population {
    /// `count` Gaussians from a function of Gaussian and column, for renders.
    pub fn from_fn(
        sh_degree: u32,
        count: usize,
        mut number: impl FnMut(usize, usize) -> f32,
    ) -> Self {
        let mut out = Self {
            sh_degree,
            count: 0,
            trains: false,
            values: Vec::new(),
            first: Vec::new(),
            second: Vec::new(),
            seen: Vec::new(),
        };
        out.grow(count);
        for gaussian in 0..count {
            for column in 0..out.columns() {
                let (row, lane) = place(out.columns(), gaussian, column);
                out.values[row][lane] = number(gaussian, column);
            }
        }
        out
    }

    /// With moments and statistics of zero, for training.
    #[must_use]
    pub fn in_training(mut self) -> Self {
        self.trains = true;
        self.grow(self.count);
        self
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Degree of the harmonics.
    pub fn sh_degree(&self) -> u32 {
        self.sh_degree
    }

    /// Numbers of a Gaussian.
    pub fn columns(&self) -> usize {
        GEOMETRY + 3 * ((self.sh_degree + 1) * (self.sh_degree + 1)) as usize
    }

    /// A number of a Gaussian.
    pub fn number(&self, gaussian: usize, column: usize) -> f32 {
        let (row, lane) = place(self.columns(), gaussian, column);
        self.values[row][lane]
    }

    /// Adam's first and second moment of a number.
    pub fn moments(&self, gaussian: usize, column: usize) -> [f32; 2] {
        let (row, lane) = place(self.columns(), gaussian, column);
        [self.first[row][lane], self.second[row][lane]]
    }

    /// Sets Adam's first and second moment of a number of a Gaussian [in
    /// training](Population::in_training).
    pub fn set_moments(&mut self, gaussian: usize, column: usize, [first, second]: [f32; 2]) {
        let (row, lane) = place(self.columns(), gaussian, column);
        self.first[row][lane] = first;
        self.second[row][lane] = second;
    }

    /// Sum of the lengths of a Gaussian's gradients by position, and the number of views in it.
    pub fn statistics(&self, gaussian: usize) -> [f32; 2] {
        self.seen[gaussian / LANES].map(|lanes| lanes[gaussian % LANES])
    }

    /// Sets [`Population::statistics`].
    pub fn set_statistics(&mut self, gaussian: usize, statistics: [f32; 2]) {
        let lanes = &mut self.seen[gaussian / LANES];
        lanes.iter_mut().zip(statistics).for_each(|(lanes, v)| lanes[gaussian % LANES] = v);
    }

    /// Makes room for `count` Gaussians; the new ones have no direction and are culled until a
    /// move fills them.
    fn grow(&mut self, count: usize) {
        let blocks = count.div_ceil(LANES);
        self.count = count.max(self.count);
        let rows = (blocks * self.columns()).max(self.values.len());
        self.values.resize(rows, [0.0; LANES]);
        if !self.trains {
            return;
        }
        self.first.resize(rows, [0.0; LANES]);
        self.second.resize(rows, [0.0; LANES]);
        self.seen.resize(blocks.max(self.seen.len()), [[0.0; LANES]; 2]);
    }

    /// Runs the moves of a densification: target and source each, with the target's new log-scales
    /// and logit. A target becomes its source, as that was before all moves, and its moments are
    /// zero. A source that also changes appears as its own target. Afterwards there are `count`
    /// Gaussians, not fewer than before.
    pub fn relocate(&mut self, moves: &[[u32; 2]], shapes: &[[f32; 4]], count: usize) {
        self.grow(count);
        let columns = self.columns();
        let number = |from: u32, column: usize| {
            let (row, lane) = place(columns, from as usize, column);
            self.values[row][lane]
        };
        let taken: Vec<f32> = { moves.iter() }
            .flat_map(|&[_, from]| (0..columns).map(move |column| number(from, column)))
            .collect();
        for ((&[to, _], shape), taken) in moves.iter().zip(shapes).zip(taken.chunks(columns)) {
            for (column, &value) in taken.iter().enumerate() {
                let (row, lane) = place(columns, to as usize, column);
                self.values[row][lane] = match column {
                    column::LOG_SCALE..column::QUAT => shape[column - column::LOG_SCALE],
                    column::LOGIT => shape[3],
                    _ => value,
                };
                self.first[row][lane] = 0.0;
                self.second[row][lane] = 0.0;
            }
            let (row, lane) = place(1, to as usize, 0);
            self.seen[row].iter_mut().for_each(|statistic| statistic[lane] = 0.0);
        }
    }
}
