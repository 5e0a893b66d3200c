//! Limits of a process that reads files of strangers: an upload's validator, or `fled prepare`.

use std::io;
use std::time::Duration;

#[cfg(unix)]
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Maximum time to read a photograph. The largest take seconds.
pub const PHOTOGRAPH_TIME: Duration = Duration::from_secs(120);

/// Address space of such a process, bytes, if it prepares small images. A frame of a video with the
/// maximum number of pixels takes 120 MB in 10 bits, and decoders keep up to 17 frames plus one per
/// thread.
pub const READER_MEMORY: u64 = 4 << 30;

/// Memory for each pixel of a prepared image, in all its forms, bytes.
const PIXEL: u64 = 36;

/// Address space of a process that prepares images of at most `side` px, two at a time, bytes.
pub fn reader_memory(side: usize) -> u64 {
    READER_MEMORY + 2 * PIXEL * (side * side) as u64
}

/// Limits the address space of this process and its children, in bytes, and disables core dumps. A
/// lower limit that the system sets already stays.
///
/// # Errors
/// If the system refuses.
#[cfg(unix)]
pub fn limit_reader(memory: u64) -> io::Result<()> {
    let at_most = |resource: Resource, bytes: u64| {
        let bytes = getrlimit(resource).maximum.map_or(bytes, |maximum| bytes.min(maximum));
        setrlimit(resource, Rlimit { current: Some(bytes), maximum: Some(bytes) })
    };
    at_most(Resource::As, memory)?;
    at_most(Resource::Core, 0)?;
    Ok(())
}

/// Refuses: what limits memory on Windows needs `unsafe` or a crate that does it for us.
///
/// # Errors
/// Always.
#[cfg(windows)]
pub fn limit_reader(_: u64) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}
