//! Opens the networks of the options `deblur` and `enhance`.

use std::path::{Path, PathBuf};

use crate::deblur::{DeblurError, Identity, Model, NetworkChoice, Onnx, Restorer};
use crate::inference::runtime;

/// The paths to search, and how to run.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenOptions<'a> {
    /// The ONNX Runtime library; if given, no other is tried.
    pub runtime: Option<&'a Path>,
    /// Files and directories to search for the library, best first, before the system's loader.
    pub search: &'a [PathBuf],
    /// Folders of networks that can be chosen by file name.
    pub models: &'a [PathBuf],
    /// Number of threads that work on one view; 0 leaves it to the library.
    pub threads: usize,
    /// Whether the run never has a guide; a network that takes none is then no fallback.
    pub unguided: bool,
}

/// A restorer, and its deviations from the request.
pub struct Opened {
    /// Ignores a guide that it has no channels for.
    pub deblurrer: Box<dyn Restorer>,
    /// One sentence per substitute, for the report.
    pub fallbacks: Vec<String>,
}

/// Opens the chosen network. Reports a network that takes no guide if it is to be given one.
///
/// # Errors
/// Any [`DeblurError`] of finding the library, finding the file, or loading it. Never falls back to
/// [`Identity`].
pub fn open(choice: &NetworkChoice, options: &OpenOptions<'_>) -> Result<Opened, DeblurError> {
    if *choice == NetworkChoice::Identity {
        return Ok(Opened { deblurrer: Box::new(Identity), fallbacks: Vec::new() });
    }
    // An unknown network is reported before a missing library.
    let model = Model::find(choice.as_str(), options.models)?;
    let runtime = runtime::load(options.runtime, options.search)?;
    let (network, warning) = Onnx::load(&runtime, &model, options.threads)?;
    let mut fallbacks = Vec::from_iter(warning);
    let info = network.describe();
    if info.channels != 6 && !options.unguided {
        fallbacks.push(format!(
            "network {} takes no guide; rounds after the first restore their views without one",
            info.id
        ));
    }
    Ok(Opened { deblurrer: Box::new(network), fallbacks })
}

/// Opens the network of the option `enhance`; `None` for `curve`.
///
/// # Errors
/// As [`open`]; [`DeblurError::ModelUnusable`] when it requires a guide.
pub fn open_enhancer(
    enhance: &NetworkChoice,
    options: &OpenOptions<'_>,
) -> Result<Option<Opened>, DeblurError> {
    if *enhance == NetworkChoice::Curve {
        return Ok(None);
    }
    // It never receives a guide, so there is nothing to report about one.
    let unguided = OpenOptions { unguided: true, ..*options };
    let opened = open(enhance, &unguided)?;
    let info = opened.deblurrer.describe();
    if info.channels == 6 {
        let detail = "it requires a guide; a network that brightens takes 3 channels".to_owned();
        return Err(DeblurError::ModelUnusable { id: info.id, detail });
    }
    Ok(Some(opened))
}
