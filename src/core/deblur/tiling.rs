//! Cuts a view into overlapping tiles, pads them, and joins the results.

use crate::image::Image;

/// Largest number of pixels processed as one tile. A quarter above 1120x640; the default network
/// then needs about 400 MiB.
pub const WHOLE: usize = 1_500_000;

/// Side of a tile of larger views, px.
pub const TILE: usize = 1024;

/// Length over which neighbouring tiles are cross-faded, px.
pub const FEATHER: usize = 96;

/// A rectangle of a view, px.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// Left edge.
    pub x: usize,
    /// Top edge.
    pub y: usize,
    /// Width.
    pub width: usize,
    /// Height.
    pub height: usize,
}

/// The tiles of a view of `width` x `height`: one up to [`WHOLE`] pixels, else tiles of at most
/// [`TILE`] px, evenly spread, that overlap by at least [`FEATHER`].
pub fn plan(width: usize, height: usize) -> Vec<Tile> {
    if width * height <= WHOLE {
        return vec![Tile { x: 0, y: 0, width, height }];
    }
    let mut tiles = Vec::new();
    for (y, tile_height) in spans(height) {
        tiles.extend(spans(width).into_iter().map(|(x, width)| Tile {
            x,
            y,
            width,
            height: tile_height,
        }));
    }
    tiles
}

/// Starts and lengths that cover `0..length`.
fn spans(length: usize) -> Vec<(usize, usize)> {
    if length <= TILE {
        return vec![(0, length)];
    }
    let gaps = (length - TILE).div_ceil(TILE - FEATHER);
    (0..=gaps).map(|i| ((length - TILE) * i / gaps, TILE)).collect()
}

/// A tile of several images, channel after channel, [3 * images, height, width], padded at the
/// right and at the bottom by reflection.
pub fn cut(images: &[&Image], tile: Tile, width: usize, height: usize) -> Vec<f32> {
    let mut out = Vec::with_capacity(3 * images.len() * width * height);
    let columns: Vec<usize> = (0..width).map(|x| tile.x + reflect(x, tile.width)).collect();
    for image in images {
        for channel in 0..3 {
            let plane = image.plane(channel);
            for y in 0..height {
                let row = &plane[(tile.y + reflect(y, tile.height)) * image.width()..];
                out.extend(columns.iter().map(|&x| row[x]));
            }
        }
    }
    out
}

/// Index into `0..length` for a position beyond it, reflected without repeating the edge, as often
/// as needed.
fn reflect(position: usize, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let folded = position % (2 * (length - 1));
    folded.min(2 * (length - 1) - folded)
}

/// Weighted sums of tiles.
pub struct Join {
    sum: Image,
    weights: Vec<f32>,
}

impl Join {
    pub fn new(width: usize, height: usize) -> Self {
        Self { sum: Image::new(width, height), weights: vec![0.0; width * height] }
    }

    /// Adds a tile's values, [3, rows, stride], of which only the unpadded part is used. `stride`
    /// and `rows` are the padded sides.
    pub fn add(&mut self, tile: Tile, values: &[f32], stride: usize, rows: usize) {
        let (width, height) = (self.sum.width(), self.sum.height());
        let across: Vec<f32> =
            (0..tile.width).map(|i| fade(i, tile.x, tile.width, width)).collect();
        for y in 0..tile.height {
            let down = fade(y, tile.y, tile.height, height);
            let at = (tile.y + y) * width + tile.x;
            for (weight, across) in self.weights[at..at + tile.width].iter_mut().zip(&across) {
                *weight += down * across;
            }
            for channel in 0..3 {
                let row = &values[(channel * rows + y) * stride..][..tile.width];
                let sums = &mut self.sum.plane_mut(channel)[at..at + tile.width];
                for ((sum, value), across) in sums.iter_mut().zip(row).zip(&across) {
                    *sum += down * across * value;
                }
            }
        }
    }

    /// The joined view, clamped to 0..=1.
    pub fn finish(mut self) -> Image {
        for channel in 0..3 {
            for (value, weight) in self.sum.plane_mut(channel).iter_mut().zip(&self.weights) {
                *value = (*value / weight).clamp(0.0, 1.0);
            }
        }
        self.sum
    }
}

/// Weight of pixel `i` of a tile at `start`: rises over [`FEATHER`] from edges that other tiles
/// overlap, 1 elsewhere. Never 0, so that every pixel has a weight.
fn fade(i: usize, start: usize, length: usize, whole: usize) -> f32 {
    let ramp = |distance: usize| ((distance as f32 + 0.5) / FEATHER as f32).min(1.0);
    let left = if start > 0 { ramp(i) } else { 1.0 };
    let right = if start + length < whole { ramp(length - 1 - i) } else { 1.0 };
    left * right
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gradient(width: usize, height: usize) -> Image {
        let value = |i: usize| (i % (width * height)) as f32 / (width * height) as f32;
        Image::from_planar(width, height, (0..3 * width * height).map(value).collect())
    }

    #[test]
    fn small_views_are_one_tile_and_large_ones_overlapping_tiles() {
        assert_eq!(plan(1120, 640).len(), 1);
        for (width, height) in [(2400, 1600), (1025, 3000), (1500, 1001)] {
            let tiles = plan(width, height);
            assert!(tiles.iter().all(|tile| tile.width <= TILE && tile.height <= TILE));
            let columns: Vec<Tile> = tiles.iter().copied().filter(|tile| tile.y == 0).collect();
            assert_eq!(
                (columns[0].x, columns[columns.len() - 1].x + columns[columns.len() - 1].width),
                (0, width)
            );
            for pair in columns.windows(2) {
                assert!(pair[1].x + FEATHER <= pair[0].x + pair[0].width, "{pair:?}");
            }
        }
    }

    #[test]
    fn cutting_and_joining_returns_the_view() {
        let view = gradient(1700, 1100);
        let mut join = Join::new(1700, 1100);
        for tile in plan(1700, 1100) {
            let [width, height] = [tile.width, tile.height].map(|side| side.next_multiple_of(16));
            join.add(tile, &cut(&[&view], tile, width, height), width, height);
        }
        let joined = join.finish();
        let worst =
            joined.data().iter().zip(view.data()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-6, "{worst}");
    }

    #[test]
    fn padding_mirrors_without_repeating_the_edge() {
        let indices: Vec<usize> = (0..8).map(|i| reflect(i, 3)).collect();
        assert_eq!(indices, [0, 1, 2, 1, 0, 1, 2, 1]);
        assert_eq!(reflect(5, 1), 0);
    }

    #[test]
    fn guide_channels_follow_the_view() {
        let (view, guide) = (Image::new(2, 2), gradient(2, 2));
        let tile = Tile { x: 0, y: 0, width: 2, height: 2 };
        let both = cut(&[&view, &guide], tile, 2, 2);
        assert_eq!((&both[..12], &both[12..]), (view.data(), guide.data()));
    }
}
