//! Text files as editors and shells of every system write them.

use std::path::Path;

use super::PosesError;

/// The text of a file, after its byte order mark: UTF-8, or UTF-16 where the mark says so. What is
/// no UTF-8 is replaced: names of photographs may be in any encoding, and the numbers beside them
/// still count.
pub fn read(file: &Path) -> Result<String, PosesError> {
    let bytes = std::fs::read(file).map_err(PosesError::io(file))?;
    let wide = |bytes: &[u8], unit: fn([u8; 2]) -> u16| -> String {
        let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        char::decode_utf16(units)
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect()
    };
    Ok(match &bytes[..] {
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [0xff, 0xfe, rest @ ..] => wide(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => wide(rest, u16::from_be_bytes),
        _ => String::from_utf8_lossy(&bytes).into_owned(),
    })
}
