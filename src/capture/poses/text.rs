//! Text files as written by editors and shells of every system.

use std::path::Path;

use super::PoseFileError;
use crate::photo_path::decoded;

/// The content of a pose file.
pub fn bytes(file: &Path) -> Result<Vec<u8>, PoseFileError> {
    let bytes = std::fs::read(file).map_err(PoseFileError::io(file))?;
    if bytes.starts_with(b"version https://git-lfs") {
        let reason = "it is the pointer of Git LFS to a file: get the original file";
        return Err(PoseFileError::bad_file(file, reason));
    }
    Ok(bytes)
}

/// The text of a file, after its byte order mark: UTF-8, or UTF-16 if the mark says so. A line that
/// is not UTF-8 contains a name in another encoding, and its numbers still count.
pub fn read(file: &Path) -> Result<String, PoseFileError> {
    let bytes = bytes(file)?;
    let narrow = |bytes: &[u8]| -> String {
        let lines = bytes.split_inclusive(|&byte| byte == b'\n');
        lines.map(decoded).collect()
    };
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| -> String {
        let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    Ok(match &bytes[..] {
        [0xef, 0xbb, 0xbf, rest @ ..] => narrow(rest),
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        _ => narrow(&bytes),
    })
}
