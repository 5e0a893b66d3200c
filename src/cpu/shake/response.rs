//! The response from light to the values of images, linear between knots.

/// Number of knots, at the values 0, 1/255 .. 1.
pub const KNOTS: usize = 256;
/// Parts of the square root of light, each with the knot at which its search begins.
const STARTS: usize = 1024;

/// A response with tables for both directions.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    light: [f32; KNOTS],
    /// Light by value and value by light, above each knot but the last.
    slopes: [[f32; 2]; KNOTS],
    starts: [u8; STARTS],
    /// Most knots within a part: this many steps find the place of any light. A search that ends
    /// early costs more, because processors cannot predict its end.
    steps: usize,
}

/// Room for the rounding of a light's part.
const SLACK: f32 = 1e-6;

/// The place of a value: the knot below, and the distance from it, in knots.
#[inline(always)]
fn place(value: f32) -> (usize, f32) {
    let at = value.max(0.0) * (KNOTS - 1) as f32;
    let knot = (at as usize).min(KNOTS - 2);
    (knot, at - knot as f32)
}

impl Response {
    /// From the strictly increasing light of every knot, 1 at the last.
    pub fn new(light: &[f32; KNOTS]) -> Self {
        let mut slopes = [[0.0; 2]; KNOTS];
        for (slope, pair) in slopes.iter_mut().zip(light.windows(2)) {
            let rise = pair[1] - pair[0];
            *slope = [(KNOTS - 1) as f32 * rise, 1.0 / ((KNOTS - 1) as f32 * rise)];
        }
        let last = KNOTS - 2;
        let knot = |least: f32| light.partition_point(|&l| l <= least).saturating_sub(1).min(last);
        let edge = |n: usize| (n as f32 / STARTS as f32).powi(2);
        let first = |n: usize| knot(edge(n) * (1.0 - SLACK));
        // Light above 1 counts to the last part.
        let end = |n: usize| if n + 1 == STARTS { last } else { knot(edge(n + 1) * (1.0 + SLACK)) };
        Self {
            light: *light,
            slopes,
            starts: std::array::from_fn(|n| first(n) as u8),
            steps: (0..STARTS).map(|n| end(n) - first(n)).max().unwrap_or(0),
        }
    }

    /// Light of a value; negative ones count as 0.
    #[inline(always)]
    pub(super) fn light(&self, value: f32) -> f32 {
        let (knot, part) = place(value);
        let low = self.light[knot];
        part.mul_add(self.light[knot + 1] - low, low)
    }

    /// Derivative of the light by a value; at a knot, the one to the right.
    #[inline(always)]
    pub(super) fn light_slope(&self, value: f32) -> f32 {
        self.slopes[place(value).0][0]
    }

    /// The value of light, and its derivative.
    #[inline(always)]
    pub(super) fn value(&self, light: f32) -> [f32; 2] {
        let part = (light.max(0.0).sqrt() * STARTS as f32) as usize;
        let mut knot = usize::from(self.starts[part.min(STARTS - 1)]);
        for _ in 0..self.steps {
            knot += usize::from(self.light[knot + 1] <= light);
            knot = knot.min(KNOTS - 2);
        }
        let slope = self.slopes[knot][1];
        let below = knot as f32 * (1.0 / (KNOTS - 1) as f32);
        [slope.mul_add(light - self.light[knot], below), slope]
    }
}
