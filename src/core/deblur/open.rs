//! From the option `deblur` to something that deblurs.

use std::path::{Path, PathBuf};

use crate::deblur::{DeblurError, Identity, Model, NetworkChoice, Onnx, Restorer};
use crate::inference::runtime;

/// Where to look and how to run.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenOptions<'a> {
    /// The ONNX Runtime library; the only one tried when given.
    pub runtime: Option<&'a Path>,
    /// Files and directories to look for the library in, best first, before the system's loader.
    pub search: &'a [PathBuf],
    /// Folders of networks that may be named by their files' names.
    pub models: &'a [PathBuf],
    /// Threads that work on one view; 0 leaves it to the library.
    pub threads: usize,
    /// The run never gives a guide, so there is nothing to say about how it would be taken.
    pub unguided: bool,
}

/// A deblurrer, and what is not as it was asked for.
pub struct Opened {
    /// Leaves a guide aside that it has no channels for.
    pub deblurrer: Box<dyn Restorer>,
    /// One sentence for each thing used in place of another; belongs into the report.
    pub fallbacks: Vec<String>,
}

/// Opens what the option means. A network that takes no guide and is to be given one says so.
///
/// # Errors
/// Any [`DeblurError`] of finding the library, finding the file, or loading it. Never falls back
/// to [`Identity`] by itself.
pub fn open(choice: &NetworkChoice, options: &OpenOptions<'_>) -> Result<Opened, DeblurError> {
    if *choice == NetworkChoice::Identity {
        return Ok(Opened {
            deblurrer: Box::new(Identity),
            fallbacks: Vec::new(),
        });
    }
    // An unknown network is told before a library that is missing.
    let model = Model::find(choice.as_str(), options.models)?;
    let runtime = runtime::load(options.runtime, options.search)?;
    let (network, said) = Onnx::load(&runtime, &model, options.threads)?;
    let mut fallbacks = Vec::from_iter(said);
    let info = network.describe();
    if info.channels != 6 && !options.unguided {
        fallbacks.push(format!(
            "network {} takes no guide: rounds after the first restore their views without one",
            info.id
        ));
    }
    Ok(Opened {
        deblurrer: Box::new(network),
        fallbacks,
    })
}

/// Opens the network that the option `enhance` means; `None` for `curve`.
///
/// # Errors
/// As [`open`]; [`DeblurError::ModelUnusable`] when it wants a guide.
pub fn open_enhancer(
    enhance: &NetworkChoice,
    options: &OpenOptions<'_>,
) -> Result<Option<Opened>, DeblurError> {
    if *enhance == NetworkChoice::Curve {
        return Ok(None);
    }
    // Never given a guide, so there is nothing to say about how it would take one.
    let unguided = OpenOptions {
        unguided: true,
        ..*options
    };
    let opened = open(enhance, &unguided)?;
    let info = opened.deblurrer.describe();
    if info.channels == 6 {
        let detail = "it wants a guide; one that brightens takes 3 channels".to_owned();
        return Err(DeblurError::ModelUnusable {
            id: info.id,
            detail,
        });
    }
    Ok(Some(opened))
}
