//! `fled models`: which networks there are, and getting more of them.

mod fetch;

use std::io::Write;
use std::path::{Path, PathBuf};

use fled_core::deblur::manifest::{Entry, Manifest, Model, Place, digest};
use fled_core::deblur::{self, DeblurError, Deblurrer, Onnx, Provider, runtime};
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
    /// Downloads a known network, when it is not here; goes on where an earlier download was stopped.
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
    /// Both sides of what it is fed are padded to a multiple of this, px.
    #[arg(long, value_name = "PX", default_value_t = 16)]
    multiple: usize,
    /// Least length of a side that it can be fed, px.
    #[arg(long, value_name = "PX", default_value_t = 16)]
    minimum_side: usize,
    /// Side of the tiles that large views are cut into, px.
    #[arg(long, value_name = "PX", default_value_t = 1024)]
    tile: usize,
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
            keep(describe(add, &known, &content)?, content, args)
        }
        Command::Fetch { id, from } => {
            let entry = find(&known, id)?;
            if entry.place(&folders) != Place::Missing {
                entry.load(&folders).map_err(failure)?;
                eprintln!("{} is here and whole", entry.id);
                return Ok(());
            }
            let folder = args.folder.first()?;
            let content = fetch::fetch(entry, from.as_deref(), &folder)?;
            let url = from.clone().or_else(|| entry.url.clone());
            keep(Entry { url, ..entry.clone() }, content, args)?;
            fetch::forget(entry, &folder);
            Ok(())
        }
    }
}

fn failure(error: DeblurError) -> Failure {
    PipelineError::from(error).into()
}

fn find<'a>(known: &'a Manifest, id: &str) -> Result<&'a Entry, Failure> {
    let ids = || known.models.iter().map(|entry| entry.id.as_str()).collect::<Vec<_>>().join(", ");
    known.find(id).ok_or_else(|| Failure::usage(format!("`{id}` is no known network; known are {}", ids())))
}

fn list(known: &Manifest, folders: &[PathBuf], json: bool) -> Result<(), Failure> {
    let written = |e| Failure::new(ErrorKind::Io, e);
    let mut out = std::io::stdout().lock();
    if json {
        let text = serde_json::to_string_pretty(known).map_err(|e| Failure::new(ErrorKind::Internal, e))?;
        return writeln!(out, "{text}").map_err(written);
    }
    for entry in &known.models {
        let place = match entry.place(folders) {
            Place::BuiltIn => "built in".to_owned(),
            Place::File(path) => path.display().to_string(),
            Place::Missing if entry.url.is_some() => format!("not here: fled models fetch {}", entry.id),
            Place::Missing => format!("not here: fled models add FILE --id {}", entry.id),
        };
        let default = if entry.default { " (default)" } else { "" };
        let guide = if entry.channels == 6 { "guided" } else { "single" };
        writeln!(out, "{:22} {guide} {:18} {place}{default}", entry.id, entry.licence).map_err(written)?;
        if let (false, Some(note)) = (entry.verified, &entry.note) {
            writeln!(out, "{:22} {note}", "").map_err(written)?;
        }
    }
    Ok(())
}

fn start(args: &Args) -> Result<runtime::Runtime, Failure> {
    runtime::load(args.onnxruntime.as_deref(), &tools::Args::library_folders()).map_err(failure)
}

fn verify(known: &Manifest, folders: &[PathBuf], ids: &[String], args: &Args) -> Result<(), Failure> {
    let wanted: Vec<&Entry> = if ids.is_empty() {
        known.models.iter().filter(|entry| entry.place(folders) != Place::Missing).collect()
    } else {
        ids.iter().map(|id| find(known, id)).collect::<Result<_, _>>()?
    };
    let runtime = start(args)?;
    let mut out = std::io::stdout().lock();
    let mut broken = 0;
    for entry in wanted {
        let verdict = entry.load(folders).and_then(|model| passed(&runtime, model));
        broken += usize::from(verdict.is_err());
        let text = verdict.map_or_else(|error| format!("BROKEN   {error}"), |on| format!("ok       {on}"));
        writeln!(out, "{:22} {text}", entry.id).map_err(|e| Failure::new(ErrorKind::Io, e))?;
    }
    if broken > 0 {
        return Err(Failure::new(ErrorKind::Environment, format!("{broken} networks cannot be used")));
    }
    Ok(())
}

/// The providers on which the network passes its self-test, as words. The CPU has to be one of them.
fn passed(runtime: &runtime::Runtime, mut model: Model) -> Result<String, DeblurError> {
    let pinned = if model.golden.is_some() { "known values" } else { "plausible values, none are known" };
    let mut network = Onnx::load_on(runtime, &model, Provider::Cpu, 0)?;
    let channels = network.describe().channels;
    model.golden = Some(network.golden()?);
    let cuda = match runtime.has_cuda().then(|| Onnx::load_on(runtime, &model, Provider::Cuda, 0)) {
        None => String::new(),
        Some(Ok(_)) => ", cuda: the same".to_owned(),
        Some(Err(error)) => format!(", cuda cannot be used: {error}"),
    };
    Ok(format!("{channels} channels, cpu: {pinned}{cuda}"))
}

/// The entry of a file that is added: that of the known network that it is said or found to be, else a new one.
fn describe(add: &AddArgs, known: &Manifest, content: &[u8]) -> Result<Entry, Failure> {
    let sha256 = digest(content);
    let same = known.models.iter().find(|entry| entry.sha256.as_ref() == Some(&sha256));
    let named = add.id.as_deref().and_then(|id| known.models.iter().find(|entry| entry.id == id));
    let mut entry = match named.or(same.filter(|_| add.id.is_none())) {
        Some(entry) => entry.clone(),
        None => {
            let stem = add.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let mut entry =
                Entry::of_file(add.id.as_deref().unwrap_or(&stem), 3, sha256, content.len() as u64);
            (entry.multiple, entry.minimum_side, entry.tile) = (add.multiple, add.minimum_side, add.tile);
            entry
        }
    };
    entry.default |= add.default;
    if let Some(licence) = &add.licence {
        entry.licence.clone_from(licence);
    }
    Ok(entry)
}

/// Tests the network on the CPU, whose output its self-test expects from then on, and puts it into the folder.
fn keep(mut entry: Entry, content: Vec<u8>, args: &Args) -> Result<(), Failure> {
    let folder = args.folder.first()?;
    let runtime = start(args)?;
    // What a new file takes is what it says itself.
    let pinned = entry.checked(content, None).map_err(failure)?;
    let unknown = Model { channels: None, ..pinned };
    let mut network = Onnx::load_on(&runtime, &unknown, Provider::Cpu, 0).map_err(failure)?;
    let channels = network.describe().channels;
    if entry.source.is_none() && entry.url.is_none() && entry.file.is_none() && channels != entry.channels {
        let described =
            Entry::of_file(&entry.id, channels, unknown.sha256.clone(), unknown.bytes.len() as u64);
        (entry.role, entry.channels, entry.order) = (described.role, described.channels, described.order);
    }
    if channels != entry.channels {
        let detail = format!("it takes {channels} channels, {} takes {}", entry.id, entry.channels);
        return Err(failure(DeblurError::ModelUnusable { id: entry.id, detail }));
    }
    let golden = network.golden().map_err(failure)?;
    (entry.sha256, entry.bytes) = (Some(unknown.sha256.clone()), Some(unknown.bytes.len() as u64));
    entry.verified = true;
    entry.check().map_err(Failure::usage)?;
    let (id, guided) = (entry.id.clone(), if channels == 6 { "guided" } else { "without a guide" });
    deblur::install(&folder, entry, &unknown.bytes, &golden).map_err(failure)?;
    eprintln!("{id} ({guided}, sha256 {}) is in {}", unknown.sha256, show(&folder));
    eprintln!("choose it with --set deblur={id}");
    Ok(())
}

fn show(folder: &Path) -> String {
    folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf()).display().to_string()
}
