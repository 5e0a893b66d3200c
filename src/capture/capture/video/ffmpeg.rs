//! Reads a video once with ffmpeg.
//!
//! The file may be hostile: only the MP4 and MOV demuxer is enabled, which opens no other file;
//! only files can be opened; and sizes and time are limited.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, absolute};
use std::process::{ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use super::error::VideoError;
use crate::cancel::CancelToken;
use crate::ffmpeg::{Words, command, is_not_started, last_line};
use crate::group::Group;

/// Maximum number of pixels of a decoded frame.
const MOST_PIXELS: usize = 40_000_000;

/// Interval at which cancellation is checked.
const POLL: Duration = Duration::from_millis(50);

/// Codecs that phones and cameras write into MP4 and MOV, by the names of ffmpeg's decoders.
const CODECS: &str = "h264,hevc,mpeg4,vp9,libvpx-vp9,av1,libdav1d,libaom-av1,mjpeg,prores,dnxhd";

/// A program and its input.
pub(super) struct Ffmpeg<'a> {
    /// The program, with leading arguments if it is one that starts ffmpeg.
    pub command: &'a [OsString],
    pub video: &'a Path,
    pub cancel: &'a CancelToken,
    /// The deadline.
    pub until: Instant,
}

/// Receives a chunk, and returns whether to continue.
type Take<'a> = &'a mut dyn FnMut(&[u8]) -> bool;

/// Where the output goes.
pub(super) enum Output<'a> {
    /// Standard output in chunks of this many bytes, until the callback ends it.
    Chunks(usize, Take<'a>),
    /// Files in a folder, which is the working directory.
    Folder(&'a Path),
}

impl Ffmpeg<'_> {
    /// Reads the video once, every frame as stored, and returns ffmpeg's log.
    ///
    /// # Errors
    /// [`VideoError`]; the process has ended by then.
    pub(super) fn run(
        &self,
        arguments: &[String],
        output: Output<'_>,
    ) -> Result<String, VideoError> {
        let mut child = self.spawn(arguments, &output)?;
        let mut drop_it = |_: &[u8]| true;
        let (length, take): (usize, Take<'_>) = match output {
            Output::Chunks(length, take) => (length, take),
            Output::Folder(_) => (1, &mut drop_it),
        };
        let (stdout, stderr) = child.outputs();
        let words = Words::of(stderr);
        let chunks = chunks(stdout, length);
        let outcome = self.follow(&mut child, &chunks, take);
        if outcome.is_err() {
            child.kill();
        }
        drop(chunks);
        let status = outcome?;
        let said = words.all(self.video);
        match status {
            Some(status) if status.code().is_some_and(is_not_started) => {
                Err(self.missing(last_line(&said).to_owned()))
            }
            Some(status) if !status.success() => Err(VideoError::of_ffmpeg(&said)),
            _ => Ok(said),
        }
    }

    fn missing(&self, reason: String) -> VideoError {
        let program = self.command.last().map(|program| program.to_string_lossy());
        VideoError::Missing { program: program.unwrap_or_default().into_owned(), reason }
    }

    fn spawn(&self, arguments: &[String], output: &Output<'_>) -> Result<Group, VideoError> {
        let pixels = MOST_PIXELS.to_string();
        // The working directory differs, and a name may begin like an option.
        let video = absolute(self.video).map_err(VideoError::io(self.video))?;
        let Some((program, first)) = self.command.split_first() else {
            return Err(self.missing("no program is named".to_owned()));
        };
        let mut command = command(program, first);
        command
            .args(["-threads", "2", "-filter_threads", "2", "-max_pixels", &pixels])
            // Frame numbers restart at a size change if filters may be reinitialised.
            .args(["-reinit_filter", "0", "-codec_whitelist", CODECS])
            .args(["-protocol_whitelist", "file,pipe", "-f", "mov", "-i"])
            .arg(video)
            // No cover picture.
            .args(["-map", "0:V:0", "-fps_mode", "passthrough", "-threads", "2"])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Output::Folder(folder) = output {
            command.current_dir(folder);
        }
        Group::spawn(&mut command).map_err(|source| self.missing(source.to_string()))
    }

    /// The exit status; `None` if it was stopped because no more output is needed.
    fn follow(
        &self,
        child: &mut Group,
        chunks: &Receiver<Vec<u8>>,
        take: Take<'_>,
    ) -> Result<Option<ExitStatus>, VideoError> {
        loop {
            self.cancel.check()?;
            if Instant::now() > self.until {
                return Err(VideoError::Timeout);
            }
            match chunks.recv_timeout(POLL) {
                Ok(chunk) if !take(&chunk) => {
                    child.kill();
                    return Ok(None);
                }
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let ended = child.try_wait();
                    let status = ended.map_err(VideoError::io(self.video))?;
                    if status.is_some() {
                        return Ok(status);
                    }
                    std::thread::sleep(POLL);
                }
            }
        }
    }
}

/// Standard output in whole chunks until it ends; a partial chunk is dropped.
fn chunks(stream: Option<impl Read + Send + 'static>, length: usize) -> Receiver<Vec<u8>> {
    let (sender, receiver) = sync_channel(4);
    if let Some(mut stream) = stream {
        std::thread::spawn(move || {
            let mut chunk = vec![0; length];
            while stream.read_exact(&mut chunk).is_ok() && sender.send(chunk.clone()).is_ok() {}
        });
    }
    receiver
}
