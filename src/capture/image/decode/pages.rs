//! Selects the page of a TIFF that is the photograph.
//!
//! Editors store thumbnails and masks in the same file, sometimes first. The decoder reads the page
//! that the file header points to, so the header is changed to point to the largest.

use std::io::{BufReader, Read, Result, Seek, SeekFrom};

use tiff::decoder::Decoder;
use tiff::tags::{ByteOrder, Tag};

/// Maximum number of pages inspected.
const MOST_PAGES: usize = 64;

/// A file whose header points to another page.
pub(super) struct Paged<R> {
    file: R,
    head: Vec<u8>,
    at: u64,
}

impl<R: Read + Seek> Paged<R> {
    /// Points to the largest page. A file with unreadable pages is left unchanged: the decoder
    /// reports the reason.
    pub(super) fn open(mut file: R) -> Result<BufReader<Self>> {
        file.rewind()?;
        let mut head = Vec::with_capacity(16);
        Read::by_ref(&mut file).take(16).read_to_end(&mut head)?;
        file.rewind()?;
        let is_big = matches!(head.get(2..4), Some([43, 0] | [0, 43]));
        head.truncate(if is_big { 16 } else { 8 });
        if let Some((page, order)) = largest(BufReader::new(&mut file)) {
            let half = head.len() / 2;
            match order {
                ByteOrder::LittleEndian => {
                    head[half..].copy_from_slice(&page.to_le_bytes()[..half]);
                }
                ByteOrder::BigEndian => {
                    head[half..].copy_from_slice(&page.to_be_bytes()[8 - half..]);
                }
            }
        }
        file.rewind()?;
        Ok(BufReader::new(Self { file, head, at: 0 }))
    }
}

impl<R: Read> Read for Paged<R> {
    fn read(&mut self, out: &mut [u8]) -> Result<usize> {
        let count = self.file.read(out)?;
        let head = self.head.get(self.at as usize..).unwrap_or_default();
        let shared = head.len().min(count);
        out[..shared].copy_from_slice(&head[..shared]);
        self.at += count as u64;
        Ok(count)
    }
}

impl<R: Seek> Seek for Paged<R> {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.at = self.file.seek(to)?;
        Ok(self.at)
    }
}

/// Offset of the page with the most pixels, the first if equal.
fn largest(file: impl Read + Seek) -> Option<(u64, ByteOrder)> {
    let mut decoder = Decoder::new(file).ok()?;
    let order = decoder.byte_order();
    let mut to_see = vec![decoder.ifd_pointer()?];
    let (mut seen, mut best) = (Vec::new(), None);
    while let (Some(page), true) = (to_see.pop(), seen.len() < MOST_PAGES) {
        if seen.contains(&page) {
            continue;
        }
        seen.push(page);
        let Ok(directory) = decoder.read_directory(page) else {
            continue;
        };
        to_see.extend(directory.next());
        let mut tags = decoder.read_directory_tags(&directory);
        let mut number = |tag| tags.find_tag_unsigned::<u64>(tag).ok().flatten();
        let pixels = number(Tag::ImageWidth).zip(number(Tag::ImageLength));
        // Bit 2 marks a mask.
        let is_mask = number(Tag::NewSubfileType).is_some_and(|kind| kind & 4 != 0);
        if let (Some((width, height)), false) = (pixels, is_mask) {
            let pixels = width.saturating_mul(height);
            if best.is_none_or(|(most, _)| pixels > most) {
                best = Some((pixels, page));
            }
        }
        if let Ok(Some(within)) = tags.find_tag(Tag::SubIfd) {
            to_see.extend(within.into_ifd_vec().unwrap_or_default());
        }
    }
    best.map(|(_, page)| (page.0, order))
}
