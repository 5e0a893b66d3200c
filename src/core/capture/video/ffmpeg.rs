//! One reading of a video by ffmpeg.
//!
//! The file may be hostile: only the demuxer of MP4 and MOV is let at it, which opens no other
//! file, nothing but files can be opened, and sizes and time are bounded.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, absolute};
use std::process::{ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use super::error::VideoError;
use crate::cancel::CancelToken;
use crate::ffmpeg::{Words, command, last_line};
use crate::group::Group;

/// Most pixels of a frame that is decoded.
const MOST_PIXELS: usize = 40_000_000;

/// How often a cancel is looked for.
const POLL: Duration = Duration::from_millis(50);

/// What phones and cameras write into MP4 and MOV, as ffmpeg calls its decoders.
const CODECS: &str = "h264,hevc,mpeg4,vp9,libvpx-vp9,av1,libdav1d,libaom-av1,mjpeg,prores,dnxhd";

/// What programs that start another end with when there is none. ffmpeg does not.
const NOT_FOUND: i32 = 127;

/// A program and what it reads.
pub(super) struct Ffmpeg<'a> {
    /// The program, and arguments before ours where it is one that starts ffmpeg.
    pub command: &'a [OsString],
    pub video: &'a Path,
    pub cancel: &'a CancelToken,
    /// When its time is over.
    pub until: Instant,
}

/// Takes a piece, and says whether more is wanted.
type Take<'a> = &'a mut dyn FnMut(&[u8]) -> bool;

/// What becomes of its output.
pub(super) enum Output<'a> {
    /// Standard output in pieces of so many bytes, until one is the last that is wanted.
    Chunks(usize, Take<'a>),
    /// Files in a folder, which it is started in.
    Folder(&'a Path),
}

impl Ffmpeg<'_> {
    /// Reads the video once, every frame as it is stored, and gives what ffmpeg said.
    ///
    /// # Errors
    /// [`VideoError`]; nothing of the process is left then.
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
            Some(status) if status.code() == Some(NOT_FOUND) => {
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
        // Where it is started is another folder, and a name may begin like an option.
        let video = absolute(self.video).map_err(VideoError::io(self.video))?;
        let Some((program, first)) = self.command.split_first() else {
            return Err(self.missing("no program is named".to_owned()));
        };
        let mut command = command(program, first);
        command
            .args(["-threads", "2", "-filter_threads", "2", "-max_pixels", &pixels])
            // Numbers of frames begin anew where a size changes, if filters may do so.
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

    /// How it ended; `None` where it was stopped because no more is wanted.
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

/// Standard output in whole pieces; ends with it, and a rest is dropped.
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
