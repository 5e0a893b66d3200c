//! Zips of pictures, compressed while streaming.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::PathBuf;

use image::{ImageDecoder as _, ImageReader};
use zip::ZipWriter;
use zip::write::{SimpleFileOptions, StreamWriter};

use super::ExportError;
use crate::run_folder::{RoundPictures, RunFolder};

/// Compression level: pictures are already compressed, so the fastest is as good as the best.
const LEVEL: i64 = 1;

/// A picture on disk.
#[derive(Debug)]
pub(super) struct Picture {
    pub(super) path: PathBuf,
    /// Without folders.
    pub(super) file_name: String,
    pub(super) bytes: u64,
}

impl Picture {
    /// Whether its values have 16 bits.
    pub(super) fn has_16_bits(&self) -> Result<bool, ExportError> {
        let reader = ImageReader::open(&self.path).map_err(ExportError::io(&self.path))?;
        let decoder = reader.into_decoder();
        let decoder = decoder.map_err(io::Error::other).map_err(ExportError::io(&self.path))?;
        let colour = decoder.original_color_type();
        Ok(colour.bits_per_pixel() == 16 * u16::from(colour.channel_count()))
    }
}

/// A zip whose entries are compressed while streaming.
pub(super) struct Archive<W: Write>(ZipWriter<StreamWriter<W>>);

impl<W: Write> Archive<W> {
    pub(super) fn new(out: W) -> Self {
        Self(ZipWriter::new_stream(out))
    }

    pub(super) fn entry(
        &mut self,
        name: &str,
        content: &mut impl io::Read,
    ) -> Result<(), ExportError> {
        // Compressed although pictures gain nothing: readers that cannot seek do not find the end
        // of an uncompressed entry.
        let options = SimpleFileOptions::default().compression_level(Some(LEVEL));
        let begun = self.0.start_file(name, options).map_err(io::Error::from);
        begun.and_then(|()| io::copy(content, &mut self.0)).map_err(ExportError::Write)?;
        Ok(())
    }

    pub(super) fn picture(&mut self, folder: &str, picture: &Picture) -> Result<(), ExportError> {
        let mut file = File::open(&picture.path).map_err(ExportError::io(&picture.path))?;
        self.entry(&format!("{folder}{}", picture.file_name), &mut file)
    }

    pub(super) fn finish(self) -> Result<(), ExportError> {
        let finished = self.0.finish().map_err(io::Error::from);
        let mut out = finished.map_err(ExportError::Write)?.into_inner();
        out.flush().map_err(ExportError::Write)
    }
}

/// The restored views, or the renders of a round, by name.
pub(super) fn pictures(run: &RunFolder, round: Option<u32>) -> Result<Vec<Picture>, ExportError> {
    let folder = match round {
        Some(round) => run.round(round).pictures(RoundPictures::Renders),
        None => run.restored(),
    };
    let mut pictures = Vec::new();
    for entry in fs::read_dir(&folder).map_err(ExportError::io(&folder))? {
        let entry = entry.map_err(ExportError::io(&folder))?;
        let path = entry.path();
        let about = entry.metadata().map_err(ExportError::io(&path))?;
        let Ok(file_name) = entry.file_name().into_string() else {
            continue;
        };
        // Names of files being written begin with a dot.
        if about.is_file() && !file_name.starts_with('.') {
            pictures.push(Picture { path, file_name, bytes: about.len() });
        }
    }
    pictures.sort_by(|a, b| a.file_name.cmp(&b.file_name));
    if pictures.is_empty() {
        return Err(ExportError::NoPictures(folder));
    }
    Ok(pictures)
}
