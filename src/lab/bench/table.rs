//! The report as one table: a line per case, followed by one per kernel.

use std::fmt::Write;

use super::report::{Case, JobTimes, KernelRow, Report};
use fled_core::event::Stage;

/// The columns; `row` has their widths.
const HEAD: [&str; 6] = ["", "ms a step", "share", "dispatches", "in MB copied", "in Mop made"];

impl Report {
    /// The report as text.
    pub fn table(&self) -> String {
        let mut out = head(self);
        out += &row(&HEAD.map(str::to_owned));
        for case in &self.cases {
            out += &case_lines(case);
        }
        if let Some(job) = &self.job {
            out += &job_lines(job);
        }
        if let Some(bytes) = self.peak_resident_bytes {
            line(
                &mut out,
                format_args!("\nThe process had at most {} MB resident.", megabytes(bytes)),
            );
        }
        out
    }
}

fn head(report: &Report) -> String {
    let (machine, roofline) = (&report.machine, &report.roofline);
    let subgroup = match machine.subgroup {
        Some((least, most)) if least == most => format!("subgroups of {least}"),
        Some((least, most)) => format!("subgroups of {least} to {most}"),
        None => "no subgroups".to_owned(),
    };
    let clock = if machine.timestamps { "" } else { ", no timestamps: kernels are not timed" };
    let mut out = String::new();
    line(
        &mut out,
        format_args!("fled {} on {} ({})", report.fled, machine.adapter, machine.driver),
    );
    line(&mut out, format_args!("{subgroup}, {} host threads{clock}", machine.threads));
    line(
        &mut out,
        format_args!(
            "roofline: {:.1} GFLOP/s, {:.2} GB/s\n",
            roofline.fma_gflops, roofline.copy_gb_per_second
        ),
    );
    out
}

fn case_lines(case: &Case) -> String {
    let mut out = String::new();
    let counts = [("visible", case.visible), ("intersections", case.intersections)];
    let counts: String = counts
        .iter()
        .filter_map(|(name, count)| count.map(|count| format!(", {count} {name}")))
        .collect();
    let sum = case.kernel_milliseconds.map_or(String::new(), |ms| format!(", kernels {ms:.3} ms"));
    line(
        &mut out,
        format_args!(
            "\n{}: {:.2}/s, {:.3} ms{sum}{}{counts}",
            case.name,
            case.steps_per_second,
            case.milliseconds,
            on_gpu(case.gpu_peak_bytes)
        ),
    );
    out + &case.kernels.iter().map(kernel_line).collect::<String>()
}

fn on_gpu(peak: Option<u64>) -> String {
    peak.map_or(String::new(), |bytes| format!(", {} MB on the GPU", megabytes(bytes)))
}

fn kernel_line(kernel: &KernelRow) -> String {
    row(&[
        format!("  {}", kernel.kernel),
        format!("{:.3}", kernel.milliseconds),
        format!("{:.1} %", 100.0 * kernel.share),
        kernel.dispatches.to_string(),
        format!("{:.2}", kernel.copies),
        format!("{:.1}", kernel.fmas),
    ])
}

fn job_lines(job: &JobTimes) -> String {
    let mut out = String::new();
    line(
        &mut out,
        format_args!(
            "\nthe whole job, preset {}: {:.1} s, {} views, {} rounds, {} steps ({:.1}/s in the last round), \
             {} Gaussians{}",
            job.preset,
            job.seconds,
            job.views,
            job.rounds,
            job.steps,
            job.steps_per_second,
            job.gaussians,
            on_gpu(job.gpu_peak_bytes)
        ),
    );
    for (stage, seconds) in
        Stage::ALL.iter().filter_map(|stage| job.stages.get_key_value(stage.name()))
    {
        line(
            &mut out,
            format_args!("  {stage:<34}{seconds:>10.2} s{:>8.1} %", 100.0 * seconds / job.seconds),
        );
    }
    for (round, between) in (1..).zip(&job.between) {
        for (part, seconds) in between.parts() {
            let name = format!("round {round}, {part} between steps");
            line(
                &mut out,
                format_args!(
                    "  {name:<34}{seconds:>10.2} s{:>8.1} %",
                    100.0 * seconds / job.seconds
                ),
            );
        }
    }
    out
}

fn row(cells: &[String; 6]) -> String {
    let [name, rest @ ..] = cells;
    let widths = [10, 9, 12, 14, 13];
    let rest: String =
        rest.iter().zip(widths).map(|(cell, width)| format!("{cell:>width$}")).collect();
    format!("{name:<34}{rest}\n")
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1}", bytes as f64 / 1e6)
}

/// Appends a line; writing to a string cannot fail.
fn line(out: &mut String, text: std::fmt::Arguments<'_>) {
    let written = writeln!(out, "{text}");
    debug_assert!(written.is_ok());
}
