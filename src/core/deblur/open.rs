//! From the option `deblur` to something that deblurs.

use std::path::{Path, PathBuf};

use crate::deblur::manifest::{Entry, Manifest, Model};
use crate::deblur::{DeblurError, Identity, NetworkChoice, Onnx, Restorer};
use crate::inference::{Runtime, runtime};

/// Where to look and how to run.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenOptions<'a> {
    /// The ONNX Runtime library; the only one tried when given.
    pub runtime: Option<&'a Path>,
    /// Files and directories to look for the library in, best first, before the system's loader.
    pub search: &'a [PathBuf],
    /// Directories that hold files of known networks.
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

/// Opens what the option means. The default is a larger network where CUDA runs it
/// ([`Manifest::default_on_cuda`]). A network that takes no guide and is to be given one says so.
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
    let model = Manifest::ask(options.models, |known| {
        known.resolve(choice.as_str(), options.models)
    })??;
    let runtime = runtime::load(options.runtime, options.search)?;
    let larger = Manifest::ask(options.models, |known| {
        let larger = larger(known, choice, runtime.has_cuda());
        larger
            .map(|entry| {
                entry
                    .load(options.models)
                    .map_err(|error| (entry.id.clone(), error))
            })
            .transpose()
    })?;
    let (network, mut fallbacks) = load(&runtime, larger.transpose(), &model, options.threads)?;
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

/// What is tried before the network that `choice` means.
pub(super) fn larger<'a>(
    known: &'a Manifest,
    choice: &NetworkChoice,
    cuda: bool,
) -> Option<&'a Entry> {
    known
        .default_on_cuda()
        .filter(|_| *choice == NetworkChoice::Default && cuda)
}

/// The larger network if CUDA runs it, else `model`; and what is not as it should be. A failure
/// comes with the network's id.
pub(super) fn load(
    runtime: &Runtime,
    larger: Option<Result<Model, (String, DeblurError)>>,
    model: &Model,
    threads: usize,
) -> Result<(Onnx, Vec<String>), DeblurError> {
    let mut fallbacks = Vec::new();
    if let Some(larger) = larger {
        let tried = larger.and_then(|larger| {
            Onnx::load_on_cuda(runtime, &larger, threads)
                .map_err(|error| (larger.id.clone(), error))
        });
        match tried {
            Ok((network, in_part)) => return Ok((network, Vec::from_iter(in_part))),
            Err((id, error)) => {
                fallbacks.push(format!(
                    "network {id}, the default on CUDA, cannot be used: {error}"
                ));
            }
        }
    }
    let (network, said) = Onnx::load(runtime, model, threads)?;
    fallbacks.extend(said);
    Ok((network, fallbacks))
}
