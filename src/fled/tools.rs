//! The resources of a run: device, COLMAP, ONNX Runtime, networks, signals.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use fled_capture::group;
use fled_core::cancel::CancelToken;
use fled_core::capture::Capture;
use fled_core::colmap::ColmapCli;
use fled_core::deblur::{self, Restorer};
use fled_core::device::Device;
use fled_core::features::{FeatureError, LearnedMatching, SearchOptions};
use fled_core::given_poses::GivenSfm;
use fled_core::inference::runtime;
use fled_core::pipeline::config::{Guide, KeyPoints, Options, PoseSource};
use fled_core::pipeline::error::{ErrorKind, PipelineError};
use fled_core::pipeline::{self};
use fled_core::poses::Sfm;
use fled_core::poses::matching::Matching;

use crate::failure::Failure;

/// Where tools lie.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Path of the COLMAP program.
    #[arg(long, value_name = "PROGRAM", default_value = "colmap", env = "FLED_COLMAP")]
    pub colmap: PathBuf,
    /// Path of the ONNX Runtime library, if `fled doctor` does not find it.
    #[arg(long, value_name = "FILE", env = "ORT_DYLIB_PATH")]
    pub onnxruntime: Option<PathBuf>,
    /// Folder that keeps poses and the costs of stages between runs; `none` keeps nothing.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Folder with the weights that find and match key points, if `fled doctor` does not find it;
    /// `none` goes without them.
    #[arg(long, value_name = "DIR", env = "FLED_MATCHER")]
    pub matcher: Option<PathBuf>,
    #[command(flatten)]
    pub models: ModelFolder,
}

/// Where what reads and writes videos lies.
#[derive(clap::Args, Clone, Debug)]
pub struct Ffmpeg {
    /// Path of the ffmpeg program, which reads and writes videos.
    #[arg(long = "ffmpeg", value_name = "PROGRAM", default_value = "ffmpeg", env = "FLED_FFMPEG")]
    pub program: PathBuf,
}

impl Ffmpeg {
    /// The command that starts it in a process that ends with this one.
    ///
    /// # Errors
    /// [`Failure`] if the path of the running program is unknown.
    pub fn command(&self) -> Result<Vec<OsString>, Failure> {
        guarded(&self.program)
    }
}

/// The command that starts a program in a process that ends with this one.
fn guarded(program: &Path) -> Result<Vec<OsString>, Failure> {
    group::guarded(program).map_err(|e| Failure::new(ErrorKind::Internal, e))
}

/// Where networks that are not built in lie.
#[derive(clap::Args, Clone, Debug)]
pub struct ModelFolder {
    /// Folder of ONNX files, whose names are the names of the networks [default: fled/models in the
    /// user's data directory].
    #[arg(long = "models", value_name = "DIR", env = "FLED_MODELS")]
    folder: Option<PathBuf>,
}

impl ModelFolder {
    /// Folders that hold networks.
    pub fn folders(&self) -> Vec<PathBuf> {
        let own = || data_home().map(|home| home.join("fled/models"));
        self.folder.clone().or_else(own).into_iter().collect()
    }
}

impl Args {
    /// Folders to search for ONNX Runtime's library; the first match wins.
    pub fn library_folders() -> Vec<PathBuf> {
        let mut folders = Vec::new();
        if let Ok(program) = std::env::current_exe()
            && let Some(folder) = program.parent()
        {
            folders.push(folder.to_owned());
            // A binary in target/release of a checkout finds what `make onnxruntime` downloaded.
            folders.extend(beside_checkout(folder, ".onnxruntime"));
        }
        if let Ok(here) = std::env::current_dir() {
            folders.push(here.join(".onnxruntime"));
        }
        folders.extend(data_home().map(|home| home.join("fled")));
        folders
    }

    /// Folders to search for the weights that find and match key points.
    pub fn matcher_folders(&self) -> Vec<PathBuf> {
        if let Some(folder) = &self.matcher {
            return vec![folder.clone()];
        }
        let mut folders = self.models.folders();
        if let Ok(program) = std::env::current_exe()
            && let Some(folder) = program.parent()
        {
            folders.push(folder.join(".matcher"));
            folders.extend(beside_checkout(folder, ".matcher"));
        }
        if let Ok(here) = std::env::current_dir() {
            folders.push(here.join(".matcher"));
        }
        folders
    }

    /// Environment variables through which a child process finds the same tools.
    pub fn environment(&self) -> Vec<(&'static str, OsString)> {
        let named = [
            ("FLED_COLMAP", Some(&self.colmap)),
            ("ORT_DYLIB_PATH", self.onnxruntime.as_ref()),
            ("FLED_MATCHER", self.matcher.as_ref()),
            ("FLED_MODELS", self.models.folder.as_ref()),
        ];
        named
            .into_iter()
            .filter_map(|(name, path)| Some((name, path?.clone().into_os_string())))
            .collect()
    }

    /// Opens the networks that find and match key points; `None` if the user disabled them.
    fn matching(&self) -> Result<Option<Arc<dyn Matching>>, FeatureError> {
        if self.matcher.as_deref() == Some(Path::new("none")) {
            return Ok(None);
        }
        let search = Self::library_folders();
        let runtime = runtime::load(self.onnxruntime.as_deref(), &search)?;
        let folders = self.matcher_folders();
        let matching = LearnedMatching::open(&runtime, &folders, SearchOptions::default())?;
        Ok(Some(Arc::new(matching)))
    }

    fn cache(&self) -> Option<PathBuf> {
        match &self.cache {
            Some(path) if path == Path::new("none") => None,
            Some(path) => Some(path.clone()),
            None => cache_home(),
        }
    }
}

/// Folders of this name at the top of the checkout whose target/release or target/debug contains
/// the program.
fn beside_checkout(program: &Path, name: &str) -> impl Iterator<Item = PathBuf> {
    program.ancestors().skip(1).take(2).map(move |up| up.join(name))
}

fn data_home() -> Option<PathBuf> {
    home(".local/share", "XDG_DATA_HOME")
}

/// The user's folder for what can be made again.
pub fn cache_home() -> Option<PathBuf> {
    home(".cache", "XDG_CACHE_HOME").map(|home| home.join("fled"))
}

fn home(below: &str, variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable)
        .map(PathBuf::from)
        .or_else(|| std::env::var_os("HOME").map(|home| PathBuf::from(home).join(below)))
}

/// Opens the device that `options` request.
///
/// # Errors
/// [`Failure`] of kind `environment`.
pub fn device(options: &Options) -> Result<Device, Failure> {
    Device::new(&options.adapter).map_err(|e| Failure::new(ErrorKind::Environment, e))
}

/// All resources of a run, owned.
pub struct Kit {
    device: Device,
    sfm: Box<dyn Sfm>,
    matching: Option<Arc<dyn Matching>>,
    deblurrer: Box<dyn Restorer>,
    enhancer: Option<Box<dyn Restorer>>,
    fallbacks: Vec<String>,
    cache: Option<PathBuf>,
}

impl Kit {
    /// Opens the networks and the pose source that `options` request, beside their device.
    ///
    /// # Errors
    /// [`Failure`] of kind `environment` with a hint, or `bad_input` if the options request given
    /// poses that the capture lacks.
    pub fn new(
        args: &Args,
        options: &Options,
        device: Device,
        capture: &Capture,
    ) -> Result<Self, Failure> {
        let (deblur::Opened { deblurrer, mut fallbacks }, enhancer) = open_networks(args, options)?;
        let enhancer = enhancer.map(|opened| {
            fallbacks.extend(opened.fallbacks);
            opened.deblurrer
        });
        let uses_networks = options.key_points == KeyPoints::Auto || options.late_views;
        let opened = if uses_networks { args.matching() } else { Ok(None) };
        let matching = match opened {
            Ok(matching) => matching,
            Err(error) => {
                fallbacks.push(format!(
                    "the networks for key points are missing: poses come from COLMAP's own key \
                     points, given poses are not refined, and the scene places no views: {error}"
                ));
                None
            }
        };
        let sfm = sfm(args, options, capture, matching.clone())?;
        Ok(Self { device, sfm, matching, deblurrer, enhancer, fallbacks, cache: args.cache() })
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Borrows the resources for a run.
    pub fn tools(&mut self) -> pipeline::Tools<'_> {
        pipeline::Tools {
            device: &self.device,
            sfm: self.sfm.as_ref(),
            matching: self.matching.as_deref(),
            deblurrer: self.deblurrer.as_mut(),
            enhancer: self.enhancer.as_mut().map(|enhancer| &mut **enhancer as &mut dyn Restorer),
            fallbacks: self.fallbacks.clone(),
            cache: self.cache.clone(),
        }
    }
}

fn sfm(
    args: &Args,
    options: &Options,
    capture: &Capture,
    matching: Option<Arc<dyn Matching>>,
) -> Result<Box<dyn Sfm>, Failure> {
    let matching = matching.filter(|_| options.key_points == KeyPoints::Auto);
    let colmap = ColmapCli::new(&args.colmap).guarded_by(guarded(&args.colmap)?);
    match (options.pose_source, &capture.poses) {
        (PoseSource::Colmap, _) | (PoseSource::Auto, None) => Ok(match matching {
            Some(matching) => Box::new(colmap.with_matching(matching)),
            None => Box::new(colmap),
        }),
        (PoseSource::Auto | PoseSource::Given, Some(given)) => {
            let mut sfm = GivenSfm::new(given).map_err(PipelineError::from)?;
            if let (PoseSource::Auto, Some(matching)) = (options.pose_source, matching) {
                let colmap = colmap.clone().with_matching(matching);
                sfm = sfm.refined_by(Box::new(move |request, given, sink, cancel| {
                    colmap.refine(request, given, sink, cancel)
                }));
            }
            let sfm = sfm.triangulated_by(Box::new(move |request, views, sink, cancel| {
                colmap.triangulate(request, views, sink, cancel)
            }));
            Ok(Box::new(sfm))
        }
        (PoseSource::Given, None) => Err(Failure::new(
            ErrorKind::BadInput,
            "pose_source is `given`, but sparse/, transforms.json and poses_bounds.npy are missing",
        )),
    }
}

fn open_networks(
    args: &Args,
    options: &Options,
) -> Result<(deblur::Opened, Option<deblur::Opened>), Failure> {
    let search = Args::library_folders();
    let open = deblur::OpenOptions {
        runtime: args.onnxruntime.as_deref(),
        search: &search,
        models: &args.models.folders(),
        threads: 0,
        unguided: options.guide == Guide::None || options.round_count() == 1,
    };
    let deblurrer = deblur::open(&options.deblur, &open);
    let enhancer = deblur::open_enhancer(&options.enhance, &open);
    Ok((deblurrer.map_err(PipelineError::from)?, enhancer.map_err(PipelineError::from)?))
}

/// Returns a token that SIGINT and SIGTERM cancel. A second SIGINT ends the process at once. A
/// second SIGTERM does not: stopping a service may signal each of its processes, and the service
/// signals its jobs too.
///
/// # Errors
/// [`Failure`] when the handlers cannot be installed.
pub fn cancel_on_signals() -> Result<CancelToken, Failure> {
    use tokio::signal::unix::{SignalKind, signal};
    let internal = |e: std::io::Error| Failure::new(ErrorKind::Internal, e);
    let token = CancelToken::new();
    let raised = token.clone();
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_io().build().map_err(internal)?;
    let (mut interrupt, mut terminate) = runtime
        .block_on(async {
            Ok::<_, std::io::Error>((
                signal(SignalKind::interrupt())?,
                signal(SignalKind::terminate())?,
            ))
        })
        .map_err(internal)?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            tokio::select! { _ = interrupt.recv() => {}, _ = terminate.recv() => {} }
            raised.cancel();
            interrupt.recv().await;
            std::process::exit(1);
        });
    });
    Ok(token)
}
