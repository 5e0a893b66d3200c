//! The results of a suite as Markdown.

use super::outcome::Outcome;
use super::statistics::{
    Cameras, Difference, LEAST_CAPTURES, LEAST_CEILING_DB, LEAST_SEEDS, Measure,
};
use super::summary::{Row, Share, Summary};

/// An empty cell.
const NOTHING: &str = "-";

/// Columns of the scores.
const SCORES: [&str; 13] = [
    "capture",
    "configuration",
    "psnr_cc, dB",
    "where seen, dB",
    "mapped, dB",
    "SSIM",
    "LPIPS",
    "fine, dB",
    "elongated Gaussians",
    "steps",
    "training, s",
    "total, s",
    "seeds",
];

impl Summary {
    /// The summary as Markdown.
    pub fn markdown(&self) -> String {
        let mut parts = vec![self.question.clone(), self.scores()];
        parts.extend(self.failures());
        parts.extend(self.differences_table());
        parts.extend(self.gain.as_ref().map(gain_table));
        parts.join("\n\n") + "\n"
    }

    fn scores(&self) -> String {
        let rows = self.rows.iter().chain(&self.means);
        table(&SCORES, rows.map(score_cells).collect())
    }

    fn failures(&self) -> Option<String> {
        let lines: Vec<String> = self
            .runs
            .iter()
            .filter_map(|run| match &run.outcome {
                Outcome::Finished(_) => None,
                Outcome::Failed(line) => Some(format!(
                    "- failed: {}, {}, seed {}: {line}",
                    run.capture, run.configuration, run.seed
                )),
            })
            .collect();
        (!lines.is_empty()).then(|| lines.join("\n"))
    }

    fn differences_table(&self) -> Option<String> {
        let first = &self.differences.first()?.over;
        let mut names: Vec<&str> = self.differences.iter().map(|d| d.of.as_str()).collect();
        names.dedup();
        let rows = names
            .iter()
            .flat_map(|name| Cameras::ALL.map(|cameras| self.difference_cells(name, cameras)))
            .collect();
        let head = [
            "configuration",
            "cameras",
            "psnr_cc, dB",
            "where seen, dB",
            "SSIM",
            "LPIPS",
            "fine, dB",
            "captures",
            "seeds",
        ];
        let claim = if self.differences.iter().all(Difference::can_be_claimed) {
            String::new()
        } else {
            format!(
                "\n\nFrom fewer than {LEAST_CAPTURES} captures or {LEAST_SEEDS} seeds no claim \
                 can be made."
            )
        };
        Some(format!(
            "Differences to {first}, of the same capture, seed and test view: mean over captures \
             and 95 % of a bootstrap over them.\n\n{}{claim}",
            table(&head, rows)
        ))
    }

    fn difference_cells(&self, name: &str, cameras: Cameras) -> Vec<String> {
        let of = |measure| {
            let mut all = self.differences.iter();
            all.find(|d| d.of == name && d.cameras == cameras && d.measure == measure)
        };
        let mut cells = vec![name.to_owned(), cameras_word(cameras).to_owned()];
        cells.extend(Measure::ALL.map(|measure| {
            of(measure).map_or(NOTHING.to_owned(), |difference| {
                with_interval(difference.mean, difference.interval, digits(measure))
            })
        }));
        let captures = of(Measure::PsnrCc).map_or(&[][..], |difference| &difference.captures);
        let seeds = captures.iter().map(|capture| capture.seeds).min();
        cells.push(captures.len().to_string());
        cells.push(seeds.unwrap_or(0).to_string());
        cells
    }
}

fn score_cells(row: &Row) -> Vec<String> {
    let capture = row.capture.clone().unwrap_or("mean".to_owned());
    let seeds = match row.failed {
        0 => row.finished.to_string(),
        failed => format!("{}, {failed} failed", row.finished),
    };
    let mut cells = vec![capture, row.configuration.clone()];
    match &row.scores {
        None => {
            cells.push("failed".to_owned());
            cells.resize(SCORES.len() - 1, NOTHING.to_owned());
        }
        Some(scores) => cells.extend([
            format!("{:.2}", scores.psnr_cc_db),
            optional(scores.psnr_cc_seen_db, 2),
            format!("{:.2}", scores.psnr_cc_mapped_db),
            format!("{:.4}", scores.ssim),
            optional(scores.lpips_squeeze, 4),
            format!("{:.2}", scores.psnr_fine_db),
            format!("{:.0} of {:.0}", scores.elongated, scores.gaussians),
            format!("{:.0}", scores.steps),
            format!("{:.0}", scores.training_seconds),
            format!("{:.0}", scores.total_seconds),
        ]),
    }
    cells.push(seeds);
    cells
}

fn gain_table(share: &Share) -> String {
    let Share { of, over, ceiling, reached } = share;
    let mut rows: Vec<Vec<String>> = reached
        .captures
        .iter()
        .map(|capture| {
            vec![
                capture.capture.clone(),
                format!("{:+.2}", capture.gained_db),
                format!("{:+.2}", capture.ceiling_db),
                if capture.counts() {
                    format!("{:+.2}", capture.share)
                } else {
                    NOTHING.to_owned()
                },
            ]
        })
        .collect();
    let mean =
        reached.mean.map_or(NOTHING.to_owned(), |mean| with_interval(mean, reached.interval, 2));
    rows.push(vec!["mean".to_owned(), NOTHING.into(), NOTHING.into(), mean]);
    let head =
        ["capture", &format!("{of} - {over}, dB"), &format!("{ceiling} - {over}, dB"), "share"];
    format!(
        "How far {of} goes from {over} to {ceiling}, in psnr_cc with registered cameras; where \
         there is more than {LEAST_CEILING_DB} dB to go.\n\n{}",
        table(&head, rows)
    )
}

fn table(head: &[&str], rows: Vec<Vec<String>>) -> String {
    let head: Vec<String> = head.iter().map(|&cell| cell.to_owned()).collect();
    let line = vec!["---".to_owned(); head.len()];
    let lines = [head, line].into_iter().chain(rows);
    // A name may contain the separator of cells.
    let cell = |cell: &String| cell.replace('|', "\\|");
    let line = |cells: Vec<String>| {
        let cells: Vec<String> = cells.iter().map(cell).collect();
        format!("| {} |", cells.join(" | "))
    };
    lines.map(line).collect::<Vec<_>>().join("\n")
}

fn with_interval(mean: f64, interval: Option<[f64; 2]>, digits: usize) -> String {
    let [low, high] = match interval {
        Some(interval) => interval,
        None => return format!("{mean:+.digits$}"),
    };
    format!("{mean:+.digits$} [{low:+.digits$}, {high:+.digits$}]")
}

fn optional(value: Option<f64>, digits: usize) -> String {
    value.map_or(NOTHING.to_owned(), |value| format!("{value:.digits$}"))
}

fn digits(measure: Measure) -> usize {
    match measure {
        Measure::PsnrCc | Measure::PsnrCcSeen | Measure::Fine => 2,
        Measure::Ssim | Measure::Lpips => 4,
    }
}

fn cameras_word(cameras: Cameras) -> &'static str {
    match cameras {
        Cameras::Registered => "registered",
        Cameras::Mapped => "mapped",
    }
}
