//! The time left of the search for poses: pairs are counted, strategies are not.

use super::work::Part;

/// Number of pairs after which their pace in this run is known.
const KNOWN_PAIRS: u64 = 10;
/// Ratio of the paces of two runs on one machine without other work that is no surprise.
const SCATTER: f64 = 1.5;
/// Share of the time so far that an unknown rest has at least in the progress.
const LEAST_REST: f64 = 0.2;

/// A strategy that is tried.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Its part, beside the pairs that it counts; `None` for a fallback, whose time is unknown.
    pub part: Option<Part>,
    began: f64,
    counted: Option<Counted>,
}

/// The photographs and pairs that the networks have matched.
#[derive(Clone, Copy, Debug)]
struct Counted {
    /// Number and time at the first report with pairs: those before it are photographs, or were
    /// kept by an interrupted search.
    first: (u64, f64),
    last: (u64, f64),
    total: u64,
}

impl Trial {
    /// The strategy with this number and letter, from a time on.
    pub fn new(number: u32, strategy: char, began: f64) -> Self {
        let part = match (number, strategy) {
            (1, 'L') => Some(Part::Mapping),
            // After the networks, COLMAP's own features always have a try.
            (1 | 2, 'A') => Some(Part::Features),
            _ => None,
        };
        Self { part, began, counted: None }
    }

    /// Takes a report of photographs and pairs.
    pub fn count(&mut self, at: f64, done: u64, total: u64, photographs: u64) {
        if self.part != Some(Part::Mapping) || done < photographs {
            return;
        }
        let first = self.counted.map_or((done, at), |counted| counted.first);
        self.counted = Some(Counted { first, last: (done, at), total });
    }

    /// The number of photographs and pairs, once pairs are counted.
    pub fn total(&self) -> Option<u64> {
        self.counted.map(|counted| counted.total)
    }

    /// Number of pairs that this run has matched, and the seconds that it took.
    pub fn pairs(&self) -> Option<(u64, f64)> {
        let Counted { first, last, .. } = self.counted?;
        (last.0 > first.0).then_some((last.0 - first.0, last.1 - first.1))
    }

    /// Seconds of a pair in this run, once it has matched some.
    pub fn pace(&self) -> Option<f64> {
        let (pairs, seconds) = self.pairs()?;
        (pairs >= KNOWN_PAIRS).then(|| seconds / pairs as f64)
    }

    /// When the last pair was matched.
    fn matched(&self) -> Option<f64> {
        let Counted { last, total, .. } = self.counted?;
        (last.0 >= total).then_some(last.1)
    }

    /// Seconds since it began, or since the last pair was matched.
    pub fn seconds(&self, at: f64) -> f64 {
        at - self.matched().unwrap_or(self.began)
    }

    /// Seconds left of the usual strategies, where `usual` has those of their parts; `None` where
    /// nothing is known, or it takes longer than usual.
    pub fn left(&self, at: f64, usual: impl Fn(Part) -> Option<f64>) -> Option<f64> {
        let rest =
            |part| usual(part).map(|usual| usual - self.seconds(at)).filter(|rest| *rest > 0.0);
        match self.part? {
            Part::Mapping => {
                let after = usual(Part::Features)?;
                if self.matched().is_some() {
                    return Some(rest(Part::Mapping)? + after);
                }
                let pairs = match (self.counted, self.pace()) {
                    (Some(counted), Some(pace)) => pace * (counted.total - counted.last.0) as f64,
                    _ => rest(Part::Pairs)?,
                };
                Some(pairs + usual(Part::Mapping)? + after)
            }
            part => rest(part),
        }
    }
}

/// Times as long as usual on this machine, because of other work beside; 1 if pairs take about as
/// long, or less: then their photographs have fewer key points.
pub fn slowness(pace: f64, usual: f64) -> f64 {
    let ratio = pace / usual;
    if ratio > SCATTER { ratio } else { 1.0 }
}

/// Seconds left for the progress, where the time left is unknown.
pub fn vague_rest(so_far: f64, expected: f64) -> f64 {
    (expected - so_far).max(LEAST_REST * so_far)
}
