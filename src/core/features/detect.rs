//! From XFeat's dense maps to key points: heat map, non-maximum suppression, refinement, and the
//! sampling of descriptors. Follows the published `detectAndCompute` except that positions are
//! refined below a pixel, and both sides of a resize keep pixel centres.

/// Channels of a descriptor.
pub(super) const DESCRIPTOR: usize = 64;

/// Side of a cell of the maps, px of the network's picture.
const CELL: usize = 8;

/// Softmax entries of a cell: its pixels, and "none of them".
pub(super) const ENTRIES: usize = CELL * CELL + 1;

/// Least heat of a key point, as published.
const LEAST_HEAT: f32 = 0.05;

/// Half the side of the window in which a key point is the hottest pixel.
const REACH: usize = 2;

/// The network's output for one picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Maps<'a> {
    /// Columns of cells.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// `[64, rows, columns]`, unit length per cell.
    pub descriptors: &'a [f32],
    /// Logits `[65, rows, columns]`.
    pub keypoints: &'a [f32],
    /// `[rows, columns]`, 0..=1.
    pub reliability: &'a [f32],
}

/// A key point in the network's picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Found {
    /// Column of the hottest pixel plus its refinement, px.
    pub x: f32,
    /// Row of the same, px.
    pub y: f32,
    /// Heat times reliability.
    pub score: f32,
    /// Unit length.
    pub descriptor: [f32; DESCRIPTOR],
}

impl Maps<'_> {
    fn width(&self) -> usize {
        self.columns * CELL
    }

    fn height(&self) -> usize {
        self.rows * CELL
    }

    /// The `most` best key points, best first.
    pub fn detect(&self, most: usize) -> Vec<Found> {
        let heat = self.heat();
        let mut found: Vec<(usize, usize, f32)> = Vec::new();
        for y in 0..self.height() {
            for x in 0..self.width() {
                if self.is_hottest(&heat, x, y) {
                    let score = heat[y * self.width() + x] * self.reliability_at(x, y);
                    found.push((x, y, score));
                }
            }
        }
        // The published sampling of the heat excludes the last column and row, and uses (0, 0) as
        // its mark for "no point".
        let is_inside =
            |x: usize, y: usize| x + 1 < self.width() && y + 1 < self.height() && (x, y) != (0, 0);
        found.retain(|&(x, y, score)| score > 0.0 && is_inside(x, y));
        // Ties are sorted by position, so that the order is the same everywhere.
        found.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.1, a.0).cmp(&(b.1, b.0))));
        found.truncate(most);
        let finished = |&(x, y, score): &(usize, usize, f32)| {
            let (dx, dy) = self.refined(&heat, x, y);
            Found {
                x: x as f32 + dx,
                y: y as f32 + dy,
                score,
                descriptor: self.descriptor_at(x as f32, y as f32),
            }
        };
        found.iter().map(finished).collect()
    }

    /// Softmax over each cell, arranged by pixel.
    fn heat(&self) -> Vec<f32> {
        let cells = self.columns * self.rows;
        let mut heat = vec![0.0; cells * CELL * CELL];
        for cell in 0..cells {
            let logit = |entry: usize| self.keypoints[entry * cells + cell];
            let highest = (0..ENTRIES).map(logit).fold(f32::MIN, f32::max);
            let total: f32 = (0..ENTRIES).map(|entry| (logit(entry) - highest).exp()).sum();
            let (row, column) = (cell / self.columns, cell % self.columns);
            for entry in 0..CELL * CELL {
                let (y, x) = (row * CELL + entry / CELL, column * CELL + entry % CELL);
                heat[y * self.width() + x] = (logit(entry) - highest).exp() / total;
            }
        }
        heat
    }

    fn is_hottest(&self, heat: &[f32], x: usize, y: usize) -> bool {
        let (width, height) = (self.width(), self.height());
        let here = heat[y * width + x];
        let rows = y.saturating_sub(REACH)..(y + REACH + 1).min(height);
        here > LEAST_HEAT
            && rows.into_iter().all(|row| {
                let columns = x.saturating_sub(REACH)..(x + REACH + 1).min(width);
                heat[row * width..][columns].iter().all(|&other| other <= here)
            })
    }

    /// Offset to the peak of the parabola through the logarithms of the heat beside a pixel, at
    /// most half a pixel.
    fn refined(&self, heat: &[f32], x: usize, y: usize) -> (f32, f32) {
        let (width, height) = (self.width(), self.height());
        let log = |x: usize, y: usize| heat[y * width + x].max(1e-6).ln();
        let peak = |before: f32, here: f32, after: f32| {
            let curvature = before - 2.0 * here + after;
            if curvature < -1e-6 {
                (0.5 * (before - after) / curvature).clamp(-0.5, 0.5)
            } else {
                0.0
            }
        };
        let inside = |at: usize, size: usize| (1..size - 1).contains(&at);
        let here = log(x, y);
        let dx = match inside(x, width) {
            true => peak(log(x - 1, y), here, log(x + 1, y)),
            false => 0.0,
        };
        let dy = match inside(y, height) {
            true => peak(log(x, y - 1), here, log(x, y + 1)),
            false => 0.0,
        };
        (dx, dy)
    }

    /// Position of a pixel among the cells, by the published sampling (`x / (width - 1)` on a grid
    /// whose corners are those of the outer pixels).
    fn among_cells(&self, x: f32, y: f32) -> (f32, f32) {
        let along =
            |at: f32, side: usize, cells: usize| at / (side - 1) as f32 * cells as f32 - 0.5;
        (along(x, self.width(), self.columns), along(y, self.height(), self.rows))
    }

    fn reliability_at(&self, x: usize, y: usize) -> f32 {
        let (at_x, at_y) = self.among_cells(x as f32, y as f32);
        let (left, top) = (at_x.floor(), at_y.floor());
        let (fx, fy) = (at_x - left, at_y - top);
        let corners = [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ];
        let weighed = corners.into_iter().map(|(right, below, weight)| {
            let cell = self.cell(left as isize + right, top as isize + below);
            cell.map_or(0.0, |cell| weight * self.reliability[cell])
        });
        weighed.sum()
    }

    /// Bicubic interpolation, normalised to unit length.
    fn descriptor_at(&self, x: f32, y: f32) -> [f32; DESCRIPTOR] {
        let (at_x, at_y) = self.among_cells(x, y);
        let (left, top) = (at_x.floor(), at_y.floor());
        let (by_x, by_y) = (cubic(at_x - left), cubic(at_y - top));
        let cells = self.columns * self.rows;
        let mut out = [0.0; DESCRIPTOR];
        for (row, weight_y) in (-1..3).zip(by_y) {
            for (column, weight_x) in (-1..3).zip(by_x) {
                let Some(cell) = self.cell(left as isize + column, top as isize + row) else {
                    continue;
                };
                for (channel, value) in out.iter_mut().enumerate() {
                    *value += weight_x * weight_y * self.descriptors[channel * cells + cell];
                }
            }
        }
        let length = out.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-12);
        out.map(|value| value / length)
    }

    /// Index of a cell; `None` outside the map, which counts as 0.
    fn cell(&self, column: isize, row: isize) -> Option<usize> {
        let column = usize::try_from(column).ok().filter(|&at| at < self.columns)?;
        let row = usize::try_from(row).ok().filter(|&at| at < self.rows)?;
        Some(row * self.columns + column)
    }
}

/// Weights of the four neighbours at -1, 0, 1, 2 for a position `t` beyond 0: Keys's kernel with
/// PyTorch's -0.75.
fn cubic(t: f32) -> [f32; 4] {
    const A: f32 = -0.75;
    let near = |d: f32| ((A + 2.0) * d - (A + 3.0)) * d * d + 1.0;
    let far = |d: f32| ((A * d - 5.0 * A) * d + 8.0 * A) * d - 4.0 * A;
    [far(t + 1.0), near(t), near(1.0 - t), far(2.0 - t)]
}
