//! One reading of a video by ffmpeg.
//!
//! The file may be hostile: only the demuxer of MP4 and MOV is let at it, which opens no other
//! file, nothing but files can be opened, and sizes and time are bounded.

use std::io::Read;
use std::path::{Path, absolute};
use std::process::Stdio;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use process_wrap::std::{ChildWrapper, CommandWrap, ProcessGroup};

use super::error::VideoError;
use crate::cancel::CancelToken;
use crate::ffmpeg::{Words, command};

/// Most pixels of a frame that is decoded.
const MOST_PIXELS: usize = 40_000_000;

/// How often a cancel is looked for.
const POLL: Duration = Duration::from_millis(50);

/// What phones and cameras write into MP4 and MOV, as ffmpeg calls its decoders.
const CODECS: &str = "h264,hevc,mpeg4,vp9,libvpx-vp9,av1,libdav1d,libaom-av1,mjpeg,prores,dnxhd";

/// A program and what it reads.
pub(super) struct Ffmpeg<'a> {
    pub program: &'a Path,
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
    /// Reads the video once, every frame as it is stored.
    ///
    /// # Errors
    /// [`VideoError`]; nothing of the process is left then.
    pub(super) fn run(&self, arguments: &[String], output: Output<'_>) -> Result<(), VideoError> {
        let mut child = self.spawn(arguments, &output)?;
        let mut drop_it = |_: &[u8]| true;
        let (length, take): (usize, Take<'_>) = match output {
            Output::Chunks(length, take) => (length, take),
            Output::Folder(_) => (1, &mut drop_it),
        };
        let words = Words::of(child.stderr().take());
        let chunks = chunks(child.stdout().take(), length);
        let outcome = self.follow(child.as_mut(), &chunks, take);
        if outcome.is_err() {
            // It may have ended; what counts is that nothing of it is left.
            let _ = child.kill();
        }
        drop(chunks);
        if outcome? {
            return Ok(());
        }
        Err(VideoError::Unreadable {
            reason: words.last_line(self.video),
        })
    }

    fn spawn(
        &self,
        arguments: &[String],
        output: &Output<'_>,
    ) -> Result<Box<dyn ChildWrapper>, VideoError> {
        let pixels = MOST_PIXELS.to_string();
        // Where it is started is another folder, and a name may begin like an option.
        let video = absolute(self.video).map_err(VideoError::io(self.video))?;
        let mut command = command(self.program);
        command
            .args([
                "-threads",
                "2",
                "-filter_threads",
                "2",
                "-max_pixels",
                &pixels,
            ])
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
        CommandWrap::from(command)
            .wrap(ProcessGroup::leader())
            .spawn()
            .map_err(|source| VideoError::Missing {
                program: self.program.display().to_string(),
                reason: source.to_string(),
            })
    }

    /// Whether it ended well, or was stopped because no more is wanted.
    fn follow(
        &self,
        child: &mut dyn ChildWrapper,
        chunks: &Receiver<Vec<u8>>,
        take: Take<'_>,
    ) -> Result<bool, VideoError> {
        loop {
            self.cancel.check()?;
            if Instant::now() > self.until {
                return Err(VideoError::Timeout);
            }
            match chunks.recv_timeout(POLL) {
                Ok(chunk) if !take(&chunk) => {
                    let _ = child.kill();
                    return Ok(true);
                }
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    if let Some(status) = child.try_wait().map_err(VideoError::io(self.program))? {
                        return Ok(status.success());
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
