//! The evaluation as files: JSON, CSV, a table, and a page of pictures.

use std::fmt::Write as _;
use std::path::Path;

use super::error::EvaluationError;
use super::report::{Evaluation, Scores, TestView, ViewScores};
use super::{Judged, Pictures};
use fled_core::image::{EncodeFormat, Image, write_atomic};
use fled_core::pipeline::error::PipelineError;
use fled_core::run_folder::{RoundPictures, RunFolder};

/// Writes `evaluation.json`, `evaluation.csv`, `index.html` and its pictures into a folder. `round`
/// is the delivered round, whose brightened views the page shows.
///
/// # Errors
/// Writing failed.
pub fn write(
    judged: &Judged,
    run: &RunFolder,
    round: u32,
    folder: &Path,
) -> Result<(), EvaluationError> {
    let save = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        write_atomic(&path, bytes).map_err(|error| PipelineError::io(&path, error))
    };
    std::fs::create_dir_all(folder).map_err(|error| PipelineError::io(folder, error))?;
    let evaluation = &judged.evaluation;
    let json = serde_json::to_vec_pretty(evaluation).expect("figures are JSON");
    save("evaluation.json", &json)?;
    save("evaluation.csv", csv(evaluation).as_bytes())?;
    for (view, pictures) in evaluation.views.iter().zip(&judged.pictures) {
        for (what, picture) in rows_of(pictures) {
            save(&file(&view.name, what), &encoded(picture)?)?;
        }
        let enhanced = run.round(round).picture(RoundPictures::Enhanced, &view.nearest);
        let nearest = [("dark", run.input(&view.nearest)), ("brightened", enhanced)];
        for (what, from) in nearest {
            // A file that the user has removed from the run leaves a gap on the page.
            if let Ok(bytes) = std::fs::read(from) {
                save(&file(&view.name, what), &bytes)?;
            }
        }
    }
    save("index.html", page(evaluation).as_bytes())?;
    Ok(())
}

fn rows_of(pictures: &Pictures) -> [(&'static str, &Image); 2] {
    [("render", &pictures.render), ("truth", &pictures.truth)]
}

fn file(view: &str, what: &str) -> String {
    format!("{view}.{what}.jpg")
}

fn encoded(image: &Image) -> Result<Vec<u8>, PipelineError> {
    let unencodable =
        |source| PipelineError::Photograph { name: "a picture of the page".to_owned(), source };
    image.encode(EncodeFormat::Jpeg(92)).map_err(unencodable)
}

/// One line per test view, with all its scores.
pub fn csv(evaluation: &Evaluation) -> String {
    let columns = ["psnr", "psnr_cc", "psnr_fine", "ssim", "lpips_squeeze"];
    let ways = ["mapped_all", "mapped_seen", "registered_all", "registered_seen"];
    let mut text = "view,nearest,seen,moved_px".to_owned();
    for way in ways {
        for column in columns {
            let _ = write!(text, ",{way}_{column}");
        }
    }
    for view in &evaluation.views {
        let TestView { name, nearest, .. } = view;
        let _ = write!(text, "\n{name},{nearest},{:.4},{:.3}", view.seen, view.moved_px);
        for scores in [&view.mapped, &view.registered] {
            for scores in [Some(&scores.all), scores.seen.as_ref()] {
                let _ = write!(text, ",{}", cells(scores));
            }
        }
    }
    text + "\n"
}

fn cells(scores: Option<&Scores>) -> String {
    let Some(scores) = scores else {
        return ",,,,".to_owned();
    };
    let lpips = scores.lpips_squeeze.map(|value| format!("{value:.4}"));
    format!(
        "{:.3},{:.3},{:.3},{:.4},{}",
        scores.psnr_db,
        scores.psnr_cc_db,
        scores.psnr_fine_db,
        scores.ssim,
        lpips.unwrap_or_default()
    )
}

/// The scores as a Markdown table, the worst view first.
pub fn table(evaluation: &Evaluation) -> String {
    let mut text = format!(
        "{} test views at {} px, {} training views, {} Gaussians, {} of them elongated; cameras {:.2} % \
         apart\n\n| view | seen | psnr_cc, registered | as mapped | of what two views see | finer \
         than 3 px | SSIM | LPIPS | moved, px |\n|---|---|---|---|---|---|---|---|---|\n",
        evaluation.views.len(),
        evaluation.size,
        evaluation.training_views,
        evaluation.gaussians,
        evaluation.elongated,
        100.0 * evaluation.camera_error
    );
    for view in worst_first(evaluation) {
        let share = format!("{:.0} %", 100.0 * view.seen);
        let moved = format!("{:.2}", view.moved_px);
        text += &row(&view.name, &share, &view.mapped, &view.registered, &moved);
    }
    let (mapped, registered) = (&evaluation.mapped, &evaluation.registered);
    text + &row("mean", "", mapped, registered, "") + &without_lpips(evaluation)
}

/// Names the views whose LPIPS is not a number, which leave no mean.
fn without_lpips(evaluation: &Evaluation) -> String {
    let lacks = |view: &&TestView| {
        [&view.mapped, &view.registered].iter().any(|scores| scores.all.lpips_squeeze.is_none())
    };
    let names: Vec<_> = evaluation.views.iter().filter(lacks).map(|view| &*view.name).collect();
    if evaluation.lpips_network.is_none() || names.is_empty() {
        return String::new();
    }
    format!("\nThe network's LPIPS of {} is not a number, so there is no mean.\n", names.join(", "))
}

fn row(
    name: &str,
    share: &str,
    mapped: &ViewScores,
    registered: &ViewScores,
    moved: &str,
) -> String {
    let (all, seen) = (&registered.all, registered.seen);
    let seen = seen.map_or_else(|| "-".to_owned(), |seen| format!("{:.2}", seen.psnr_cc_db));
    let lpips = all.lpips_squeeze.map(|value| format!("{value:.3}"));
    format!(
        "| {name} | {share} | {:.2} | {:.2} | {seen} | {:.2} | {:.4} | {} | {moved} |\n",
        all.psnr_cc_db,
        mapped.all.psnr_cc_db,
        all.psnr_fine_db,
        all.ssim,
        lpips.unwrap_or_else(|| "-".to_owned())
    )
}

/// Test views, the worst first.
fn worst_first(evaluation: &Evaluation) -> Vec<&TestView> {
    let mut views: Vec<&TestView> = evaluation.views.iter().collect();
    let score = |view: &TestView| view.registered.all.psnr_cc_db;
    views.sort_by(|a, b| score(a).total_cmp(&score(b)));
    views
}

/// One row per test view: the nearest training view dark and brightened, the render, and the ground
/// truth. The names come from fled and contain only letters, digits, `-` and `_`.
fn page(evaluation: &Evaluation) -> String {
    let mut text = "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\">\
                    <title>Evaluation</title><style>body{background:#111;color:#ddd;font:15px \
                    sans-serif;margin:1rem}table{width:100%}td{width:25%}img{width:100%}</style>\
                    <h1>Test views, worst first</h1><table><tr><th>nearest training view<th>the \
                    same, brightened<th>render<th>truth"
        .to_owned();
    for view in worst_first(evaluation) {
        let scores = &view.registered.all;
        let _ = write!(
            text,
            "<tr><td colspan=4>{} (nearest: {}) {:.2} dB, SSIM {:.4}, {:.0} % seen by two views\
             <tr>",
            view.name,
            view.nearest,
            scores.psnr_cc_db,
            scores.ssim,
            100.0 * view.seen
        );
        for what in ["dark", "brightened", "render", "truth"] {
            let _ = write!(text, "<td><img src=\"{}\" alt=\"{what}\">", file(&view.name, what));
        }
    }
    text + "</table></html>\n"
}
