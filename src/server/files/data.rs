//! The data directory: its lock and its layout.
//!
//! ```text
//! fled.db  server.lock  incoming/<upload>/  captures/<id>/  cache/<fingerprint>.json
//! uploads/<id>  unnamed/{captures,jobs,uploads}/<id>
//! jobs/<id>/{options.json, process, log.txt, output/, renders/}
//! ```
//! Files are named by capture and job, not by content. A video is a job.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Component, Path, PathBuf};

use fled_core::pipeline::poses::CACHED;
use fled_core::run_folder::RunFolder;
use rustix::fs::{FlockOperation, flock, statvfs};

use crate::error::{Result, ServerError};

/// The folder of thumbnails within the folder of a capture. It is hidden, so the reader of captures
/// ignores it.
pub const THUMBNAILS: &str = ".thumbnails";

/// The thumbnail file of the photograph `name`, below the folder of its capture. A file beside it
/// with the extension `txt` holds the path of the photograph itself, also below that folder.
pub fn thumbnail(name: &str) -> PathBuf {
    let digest = blake3::hash(name.as_bytes()).to_hex();
    Path::new(THUMBNAILS).join(format!("{}.jpg", &digest[..32]))
}

/// Where the photograph `name` of a capture is, below its folder or in its ZIP; `None` if it was
/// never decoded.
pub fn photograph(capture: &Path, name: &str) -> Option<PathBuf> {
    let file = capture.join(thumbnail(name)).with_extension("txt");
    let place = PathBuf::from(fs::read_to_string(file).ok()?);
    // An uploaded archive may contain such a file.
    place.components().all(|part| matches!(part, Component::Normal(_))).then_some(place)
}

/// The locked data directory of a server.
#[derive(Debug)]
pub struct DataDir {
    root: PathBuf,
    /// Held for the life of the server: the kernel frees it even after kill -9. `None` if another
    /// server holds it.
    lock: Option<Lock>,
}

/// A lock on an open file, released explicitly: a process being started briefly inherits the file,
/// so closing it here would not yet free the lock.
#[derive(Debug)]
struct Lock(File);

impl Lock {
    fn take(file: File) -> Option<Self> {
        let taken = flock(&file, FlockOperation::NonBlockingLockExclusive);
        taken.is_ok().then_some(Self(file))
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        let _ = flock(&self.0, FlockOperation::Unlock);
    }
}

impl DataDir {
    /// Creates missing folders and takes the lock.
    ///
    /// # Errors
    /// [`ServerError::DataInUse`] if another server uses it; [`ServerError::Io`] otherwise.
    pub fn open(root: &Path) -> Result<Self> {
        fs::create_dir_all(root).map_err(ServerError::io(root))?;
        let data = Self::beside(root)?;
        if !data.is_ours() {
            return Err(ServerError::DataInUse(data.root));
        }
        for dir in [data.incoming(), data.captures(), data.jobs(), data.uploads()] {
            fs::create_dir_all(&dir).map_err(ServerError::io(&dir))?;
        }
        Ok(data)
    }

    /// Opens an existing directory. Takes the lock if no server holds it; until this is dropped no
    /// server can start.
    ///
    /// # Errors
    /// [`ServerError::Io`] when it does not exist or cannot be used.
    pub fn beside(root: &Path) -> Result<Self> {
        let root = root.canonicalize().map_err(ServerError::io(root))?;
        let path = root.join("server.lock");
        let lock = File::options()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .map_err(ServerError::io(&path))?;
        let lock = Lock::take(lock);
        Ok(Self { root, lock })
    }

    /// Returns whether no other server uses it.
    pub fn is_ours(&self) -> bool {
        self.lock.is_some()
    }

    /// The root of the directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The name of this installation among those that share a database. It is created once, so that
    /// the installation recognises its own jobs after a restart.
    ///
    /// # Errors
    /// [`ServerError::Io`] when it cannot be stored.
    pub fn worker(&self) -> Result<String> {
        let path = self.root.join("worker");
        match fs::read_to_string(&path) {
            Ok(name) if !name.trim().is_empty() => return Ok(name.trim().to_owned()),
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(ServerError::io(&path)(error));
            }
            _ => {}
        }
        let name = uuid::Uuid::now_v7().to_string();
        write_atomically(&path, name.as_bytes()).map_err(ServerError::io(&path))?;
        Ok(name)
    }

    /// The count of processes ended for lack of memory, see [`crate::memory::note`].
    pub fn oom_kills(&self) -> PathBuf {
        self.root.join("oom_kills")
    }

    /// The database file.
    pub fn database(&self) -> PathBuf {
        self.root.join("fled.db")
    }

    /// The folder of uploads in progress.
    pub fn incoming(&self) -> PathBuf {
        self.root.join("incoming")
    }

    /// The files of resumable uploads.
    pub fn uploads(&self) -> PathBuf {
        self.root.join("uploads")
    }

    /// The file of a resumable upload.
    pub fn upload(&self, id: &str) -> PathBuf {
        self.uploads().join(id)
    }

    /// The files of all captures.
    pub fn captures(&self) -> PathBuf {
        self.root.join("captures")
    }

    /// The files of a capture.
    pub fn capture(&self, id: &str) -> PathBuf {
        self.captures().join(id)
    }

    /// The folders of all jobs.
    pub fn jobs(&self) -> PathBuf {
        self.root.join("jobs")
    }

    /// The folder of orphans of `kept`, which is the captures, the jobs or the uploads.
    pub fn unnamed(&self, kept: &Path) -> PathBuf {
        let unnamed = self.root.join("unnamed");
        kept.file_name().map_or(unnamed.clone(), |kind| unnamed.join(kind))
    }

    /// The folder shared by all jobs: poses, and the costs of stages.
    pub fn cache(&self) -> PathBuf {
        self.root.join("cache")
    }

    /// The cached poses: a file for each capture and set of other inputs.
    pub fn cached_poses(&self) -> PathBuf {
        self.cache().join(CACHED)
    }

    /// The folder of a job.
    pub fn job(&self, id: &str) -> PathBuf {
        self.jobs().join(id)
    }

    /// The output of the job's process: the artifacts.
    pub fn output(&self, id: &str) -> RunFolder {
        output_in(&self.job(id))
    }

    /// The job's log.
    pub fn log(&self, id: &str) -> PathBuf {
        log_in(&self.job(id))
    }

    /// Rendered novel views.
    pub fn renders(&self, id: &str) -> PathBuf {
        self.job(id).join("renders")
    }

    /// The file of a video, by its own id.
    pub fn video(&self, id: &str) -> PathBuf {
        self.output(id).root().join("video.mp4")
    }

    /// Free bytes of the file system.
    ///
    /// # Errors
    /// When the file system does not report it.
    pub fn free_bytes(&self) -> io::Result<u64> {
        let stat = statvfs(&self.root)?;
        Ok(stat.f_bavail * stat.f_frsize)
    }
}

/// The output in a job's folder.
pub fn output_in(job: &Path) -> RunFolder {
    RunFolder::new(job.join("output"))
}

/// The log in a job's folder.
pub fn log_in(job: &Path) -> PathBuf {
    job.join("log.txt")
}

/// Writes a file so that after a crash either the old or the new content exists.
///
/// # Errors
/// When writing fails.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = path.with_extension("tmp");
    let mut file = File::create(&temporary)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    fs::rename(&temporary, path)?;
    sync_directory(path.parent().unwrap_or(Path::new(".")))
}

/// Bytes of all files below a folder; 0 if it does not exist.
///
/// # Errors
/// When something in it cannot be read.
pub fn bytes_below(dir: &Path) -> io::Result<u64> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(0),
        entries => entries?,
    };
    let mut sum = 0;
    for entry in entries {
        let entry = entry?;
        if entry.file_name() == THUMBNAILS {
            continue;
        }
        // A running job may replace its files meanwhile.
        match entry.metadata() {
            Ok(about) if about.is_dir() => sum += bytes_below(&entry.path())?,
            Ok(about) => sum += about.len(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    Ok(sum)
}

/// Syncs a directory to disk, so that its entries survive a power cut.
///
/// # Errors
/// When the directory cannot be opened or synchronised.
pub fn sync_directory(dir: &Path) -> io::Result<()> {
    File::open(dir)?.sync_all()
}

/// Syncs a directory and all directories below it to disk, so that their entries survive a power
/// cut.
///
/// # Errors
/// When one of them cannot be read or synchronised.
pub fn sync_directories(dir: &Path) -> io::Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            sync_directories(&entry.path())?;
        }
    }
    sync_directory(dir)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_data_directory_admits_one_server_at_a_time() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let first = DataDir::open(dir.path()).expect("free");
        assert!(matches!(DataDir::open(dir.path()), Err(ServerError::DataInUse(_))));
        // As a process inherits it while it is being started.
        let lock = first.lock.as_ref().expect("its own");
        let _inherited = lock.0.try_clone().expect("open");
        drop(first);
        DataDir::open(dir.path()).expect("free again");
    }
}
