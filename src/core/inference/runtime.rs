//! Finding and starting ONNX Runtime.
//!
//! The library is opened at run time, so that the build needs no download and no C++. fled always
//! searches for it explicitly, because `ort`'s own search panics in the middle of a run if it is
//! missing.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ort::environment::Environment;
use ort::logging::LogLevel;

use super::error::RuntimeError;

/// The library's file name on this system, and the name for the system's loader.
pub const LIBRARY: &str = if cfg!(windows) {
    "onnxruntime.dll"
} else if cfg!(target_os = "macos") {
    "libonnxruntime.dylib"
} else {
    "libonnxruntime.so"
};

/// The part of the library for NVIDIA GPUs.
pub(crate) const CUDA_LIBRARY: &str = if cfg!(windows) {
    "onnxruntime_providers_cuda.dll"
} else {
    "libonnxruntime_providers_cuda.so"
};

/// A started ONNX Runtime.
#[derive(Clone, Debug)]
pub struct Runtime {
    environment: Environment,
    info: RuntimeInfo,
}

/// The library in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RuntimeInfo {
    /// Its path; only a file name if the system's loader found it and does not report the path
    /// (outside Linux).
    pub path: PathBuf,
    /// `1.x`.
    pub version: String,
}

impl Runtime {
    /// The facts for `doctor` and the report.
    pub fn info(&self) -> &RuntimeInfo {
        &self.info
    }

    /// Whether the library's CUDA part is beside it. Only loading a network on it shows whether it
    /// works.
    pub fn has_cuda(&self) -> bool {
        // The parent of a mere file name is empty: the system's loader does not search the current
        // folder.
        let folder = self.info.path.parent().filter(|folder| !folder.as_os_str().is_empty());
        folder.is_some_and(|folder| folder.join(CUDA_LIBRARY).is_file())
    }

    pub(crate) fn environment(&self) -> &Environment {
        &self.environment
    }
}

/// A process can hold only one ONNX Runtime, because `ort` keeps the first library for good. This
/// static does so too, and never releases it, because the library's own clean-up at exit has
/// crashed before.
static STARTED: Mutex<Option<Runtime>> = Mutex::new(None);

/// Finds the library and starts it. Tries only the `explicit` path if given; else each entry of
/// `search` (a file, or a directory with [`LIBRARY`]) in order, then the system's loader. Later
/// calls return the runtime of the first.
///
/// # Errors
/// [`RuntimeError::Missing`] with the fault of every path, or [`RuntimeError::Unusable`].
pub fn load(explicit: Option<&Path>, search: &[PathBuf]) -> Result<Runtime, RuntimeError> {
    let found = find(explicit, search)?;
    let mut started = STARTED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(runtime) = started.as_ref() {
        return Ok(runtime.clone());
    }
    let runtime = start(found)?;
    *started = Some(runtime.clone());
    Ok(runtime)
}

/// Finds the library without starting it.
///
/// # Errors
/// [`RuntimeError::Missing`] with the fault of every path.
pub fn find(explicit: Option<&Path>, search: &[PathBuf]) -> Result<RuntimeInfo, RuntimeError> {
    let candidates = match explicit {
        Some(path) => vec![path.to_path_buf()],
        None => search.iter().cloned().chain([PathBuf::from(LIBRARY)]).collect(),
    };
    let mut tried = Vec::new();
    for candidate in candidates {
        match probe(candidate) {
            Ok(info) => return Ok(info),
            Err(reason) => tried.push(reason),
        }
    }
    Err(RuntimeError::Missing { tried })
}

fn probe(candidate: PathBuf) -> Result<RuntimeInfo, String> {
    let path = if candidate.is_dir() { candidate.join(LIBRARY) } else { candidate };
    let by_loader = path.as_os_str() == LIBRARY;
    if !by_loader && !path.is_file() {
        return Err(format!("{}: no such file", path.display()));
    }
    // An absolute path: `ort` resolves a relative one against the executable.
    let path = if by_loader { path } else { path.canonicalize().unwrap_or(path) };
    match ort::util::probe(&path) {
        Some(minor) if minor >= ort::MINOR_VERSION => {
            Ok(RuntimeInfo { path, version: format!("1.{minor}") })
        }
        Some(minor) => Err(format!(
            "{}: version 1.{minor}, at least 1.{} is needed",
            path.display(),
            ort::MINOR_VERSION
        )),
        None if by_loader => Err("the system's loader: not found".to_owned()),
        None => Err(format!("{}: not an ONNX Runtime library for this machine", path.display())),
    }
}

fn start(mut info: RuntimeInfo) -> Result<Runtime, RuntimeError> {
    let unusable = |detail: String| RuntimeError::Unusable { path: info.path.clone(), detail };
    let environment = ort::init_from(&info.path)
        .map_err(|e| unusable(e.to_string()))?
        .with_name("fled")
        .with_telemetry(false)
        .build()
        .map_err(|e| unusable(e.to_string()))?;
    environment.set_log_level(LogLevel::Warning);
    if info.path.as_os_str() == LIBRARY
        && let Ok(maps) = std::fs::read_to_string("/proc/self/maps")
        && let Some(path) = mapped(&maps)
    {
        info.path = path;
    }
    Ok(Runtime { environment, info })
}

/// The library's file in Linux's list of the process's mappings.
fn mapped(maps: &str) -> Option<PathBuf> {
    let paths = maps.lines().filter_map(|line| line.find('/').map(|at| Path::new(&line[at..])));
    let is_library = |path: &&Path| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(LIBRARY))
    };
    paths.filter(is_library).map(Path::to_path_buf).next()
}

/// The tests' runtime, as if it had been found in `folder`.
#[cfg(test)]
pub(crate) fn as_if_in(folder: &Path) -> Runtime {
    let runtime = for_tests();
    let info = RuntimeInfo { path: folder.join(LIBRARY), version: runtime.info.version };
    Runtime { environment: runtime.environment, info }
}

/// The library that `make onnxruntime` fetched, for the tests of this crate.
#[cfg(test)]
pub(crate) fn for_tests() -> Runtime {
    let local = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.onnxruntime");
    match load(None, &[local]) {
        Ok(runtime) => runtime,
        Err(error) => panic!("{error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_of_a_missing_library_says_what_to_run() {
        let error =
            load(Some(Path::new("/nowhere/libonnxruntime.so")), &[]).expect_err("not there");
        let text = error.to_string();
        assert!(text.contains("make onnxruntime") && text.contains("/nowhere/"), "{text}");
    }

    #[test]
    fn an_error_names_a_file_that_is_no_library_and_the_reason() {
        let directory = tempfile::tempdir().expect("temporary directory");
        std::fs::write(directory.path().join(LIBRARY), "not a library").expect("write");
        let error = find(Some(directory.path()), &[]).expect_err("not a library");
        assert!(error.to_string().contains("not an ONNX Runtime library"), "{error}");
    }

    #[test]
    fn the_search_continues_past_folders_without_a_library() {
        let empty = tempfile::tempdir().expect("temporary directory");
        let local = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.onnxruntime");
        let found = find(None, &[empty.path().to_path_buf(), local.clone()]);
        let found = found.unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(found.path, local.join(LIBRARY).canonicalize().expect("fetched"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_path_of_a_library_found_by_the_loader_is_known() {
        let started = for_tests().info().path.clone();
        let maps = std::fs::read_to_string("/proc/self/maps").expect("Linux");
        assert_eq!(mapped(&maps), Some(started));
        assert_eq!(
            mapped("7f-80 r-xp 0 fe:00 12   /usr/lib/my libs/libonnxruntime.so.1.31.1\n"),
            Some(PathBuf::from("/usr/lib/my libs/libonnxruntime.so.1.31.1"))
        );
        assert_eq!(
            mapped("7f-80 r-xp 0 fe:00 12   /usr/lib/libc.so.6\n7f-80 rw-p 0 00:00 0\n"),
            None
        );
    }

    #[test]
    fn the_first_runtime_of_a_process_is_kept() {
        let first = for_tests();
        assert_eq!(for_tests().info(), first.info());
    }
}
