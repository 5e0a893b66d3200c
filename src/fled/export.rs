//! `fled export`: a finished result in the formats of other programs.

use std::fs::{self, File};
use std::path::{Path, PathBuf};

use fled_core::capture::{is_of_a_run, limit_reader};
use fled_core::export::{Export, ExportError, MOST_SH_DEGREE, Trim};
use fled_core::gaussians::crop::Crop;
use fled_core::mesh::Detail;
use fled_core::pipeline::error::ErrorKind;
use fled_core::run_folder::RunFolder;

use crate::failure::{Failure, io};

/// Arguments of `fled export`.
#[derive(clap::Args)]
pub struct Args {
    /// Output folder of `fled run`.
    run: PathBuf,
    #[arg(value_name = "FORM", help = forms())]
    export: Export,
    /// Output file [default: that name in the current folder].
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Exports this round instead of the delivered one.
    #[arg(long)]
    round: Option<u32>,
    /// Keeps only the Gaussians whose centres lie in a shape around X, Y, Z, in the world of the
    /// poses: box:X,Y,Z,WIDTH,HEIGHT,DEPTH or sphere:X,Y,Z,RADIUS.
    #[arg(long, value_name = "SHAPE")]
    crop: Option<Crop>,
    /// Multiplies all lengths, for example by the metres of a unit of the poses' world: in the node
    /// of scene.glb, scene.usda and mesh.glb, elsewhere in the coordinates themselves.
    #[arg(long, value_name = "FACTOR", value_parser = scale)]
    scale: Option<f64>,
    /// Degree of the harmonics: cuts those of the scene or pads them with zeros.
    #[arg(long, value_name = "N",
        value_parser = clap::value_parser!(u32).range(0..=i64::from(MOST_SH_DEGREE)))]
    sh_degree: Option<u32>,
    /// Most triangles of a mesh: its voxels grow until it has no more [default: 200000, or any
    /// number with `--voxel`].
    #[arg(long, value_name = "N", value_parser = triangles)]
    triangles: Option<usize>,
    /// Side of a mesh's voxels, in units of the poses' world [default: three pixels of the views at
    /// the scene's median depth].
    #[arg(long, value_name = "LENGTH", value_parser = voxel)]
    voxel: Option<f64>,
    /// Bytes of address space; the process ends if it needs more.
    #[arg(long, value_name = "BYTES", hide = true)]
    memory: Option<u64>,
}

fn scale(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("`{text}` is not a number")).and_then(Trim::scale)
}

fn triangles(text: &str) -> Result<usize, String> {
    text.parse().map_err(|_| format!("`{text}` is not a number")).and_then(Detail::triangles)
}

fn voxel(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("`{text}` is not a number")).and_then(Detail::voxel)
}

fn forms() -> String {
    format!("Export to write: {}", Export::ALL.map(Export::name).join(", "))
}

/// Writes one export.
///
/// # Errors
/// [`Failure`] if the run lacks the required files, or the file cannot be written.
pub fn main(args: &Args) -> Result<(), Failure> {
    if let Some(memory) = args.memory {
        limit_reader(memory).map_err(|error| Failure::new(ErrorKind::Io, error))?;
    }
    let run = RunFolder::new(&args.run);
    let mesh = Detail { triangles: args.triangles, voxel: args.voxel };
    let trim = Trim { crop: args.crop, sh_degree: args.sh_degree, scale: args.scale, mesh };
    let prepared = args.export.prepare(&run, args.round, trim)?;
    let output = args.output.clone();
    let output = output.unwrap_or_else(|| args.export.name().into());
    if is_of_run(&output, &run) {
        return Err(Failure::usage(format!(
            "{} is a file of the run itself: choose another with -o",
            output.display()
        )));
    }
    if args.output.is_none() && args.export == Export::Transforms && output.exists() {
        return Err(Failure::usage(
            "transforms.json exists here and may be the poses of a capture: name the file with -o",
        ));
    }
    let prepared = prepared.meshed()?;
    let temporary = output.with_added_extension("tmp");
    let file = File::create(&temporary).map_err(io(&temporary))?;
    if let Err(error) = prepared.write(&file) {
        // Remove the incomplete file; a failure to do so matters less than the first error.
        let _ = fs::remove_file(&temporary);
        return Err(error.into());
    }
    fs::rename(&temporary, &output).map_err(io(&output))?;
    if let Some(facts) = prepared.facts() {
        eprintln!("{facts}");
    }
    Ok(())
}

/// Whether a path is that of a file that the run left.
fn is_of_run(path: &Path, run: &RunFolder) -> bool {
    let (Ok(path), Ok(root)) = (fs::canonicalize(path), fs::canonicalize(run.root())) else {
        return false;
    };
    let below = path.strip_prefix(root).ok().and_then(Path::to_str);
    below.is_some_and(is_of_a_run)
}

impl From<ExportError> for Failure {
    fn from(error: ExportError) -> Self {
        let missing = error.is_missing();
        let is_usage = match &error {
            ExportError::NothingLeft(_) => false,
            ExportError::EightBits(_) => true,
            error => error.is_of_wish(),
        };
        if is_usage {
            return Self::usage(error);
        }
        let kind = match error {
            ExportError::Write(_) => ErrorKind::Io,
            _ => ErrorKind::BadInput,
        };
        let failure = Self::new(kind, error);
        if missing {
            return Self {
                hint: "Give the output folder of a finished `fled run`, or one of its rounds."
                    .to_owned(),
                ..failure
            };
        }
        failure
    }
}
