//! `fled models`: lists the networks and checks that they can be used.

use std::io::Write;
use std::path::PathBuf;

use fled_core::deblur::{BUILT_IN, DeblurError, Model, Onnx, Restorer, network_names};
use fled_core::inference::runtime::{self, Runtime};
use fled_core::pipeline::error::{ErrorKind, PipelineError};

use crate::failure::Failure;
use crate::tools;

/// Arguments of `fled models`.
#[derive(clap::Args)]
pub struct Args {
    /// Path of the ONNX Runtime library, if `fled doctor` does not find it.
    #[arg(long, value_name = "FILE", env = "ORT_DYLIB_PATH")]
    onnxruntime: Option<PathBuf>,
    #[command(flatten)]
    folder: tools::ModelFolder,
}

/// Prints every network: the built-in one and the files of the folder.
///
/// # Errors
/// [`Failure`] of kind `environment` if one cannot be used.
pub fn main(args: &Args) -> Result<(), Failure> {
    let folders = args.folder.folders();
    let runtime = runtime::load(args.onnxruntime.as_deref(), &tools::Args::library_folders())
        .map_err(|error| PipelineError::from(DeblurError::from(error)))?;
    let mut out = std::io::stdout().lock();
    let mut broken = 0;
    for name in network_names(&folders) {
        let verdict = verdict(&runtime, &name, &folders);
        broken += usize::from(verdict.is_err());
        let text = verdict.unwrap_or_else(|error| format!("BROKEN   {error}"));
        writeln!(out, "{name:22} {text}").map_err(|e| Failure::new(ErrorKind::Io, e))?;
    }
    if broken > 0 {
        let detail = format!("{broken} networks cannot be used");
        return Err(Failure::new(ErrorKind::Environment, detail));
    }
    Ok(())
}

/// Describes a network after it has passed its self-test as in a run.
fn verdict(runtime: &Runtime, name: &str, folders: &[PathBuf]) -> Result<String, DeblurError> {
    let (network, note) = Onnx::load(runtime, &Model::find(name, folders)?, 0)?;
    let info = network.describe();
    let role = if info.channels == 6 { "guided" } else { "single" };
    let default = if name == BUILT_IN { "; built in, the default" } else { "" };
    let note = note.map(|note| format!("; {note}")).unwrap_or_default();
    Ok(format!("ok       {role} on {}, sha256 {}{default}{note}", info.provider, info.sha256))
}
