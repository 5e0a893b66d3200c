//! `Upload-Metadata`: the name of an upload.

use std::collections::HashMap;

use axum::http::HeaderMap;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::fields::{METADATA, bad, text, unfit};
use crate::http::problem::Problem;
use crate::http::texts::check_text;
use crate::http::upload::LONGEST_FILE_NAME;

/// Maximum length of the metadata in bytes: they are stored with every upload.
const LONGEST: usize = 8 << 10;

/// The metadata as sent, and what they say.
#[derive(Debug)]
pub(super) struct Metadata {
    pub(super) sent: String,
    pub(super) filename: String,
    /// Whether `for` announces that a job will be made of it.
    pub(super) is_for_job: bool,
}

impl Metadata {
    /// # Errors
    /// 400 if they cannot be read, 422 if they are too long or have no file name in plain text.
    pub(super) fn of(headers: &HeaderMap) -> Result<Self, Problem> {
        let sent = text(headers, &METADATA)?.unwrap_or_default();
        if sent.len() > LONGEST {
            return Err(unfit(format!("`Upload-Metadata` has more than {LONGEST} bytes.")));
        }
        let read = pairs(sent).ok_or_else(|| {
            bad("`Upload-Metadata` must consist of distinct keys, each with a value in base64.")
        })?;
        // Uppy sends a file's path here, and `null` if it has no folder.
        let path = read.get("relativePath").filter(|path| !matches!(&path[..], b"" | b"null"));
        let filename = path.or(read.get("filename")).cloned().unwrap_or_default();
        match String::from_utf8(filename) {
            Ok(filename) if (1..=LONGEST_FILE_NAME).contains(&filename.len()) => {
                check_text(&filename, "/filename")?;
                let is_for_job = read.get("for").is_some_and(|purpose| purpose == b"job");
                Ok(Self { sent: sent.to_owned(), filename, is_for_job })
            }
            _ => Err(unfit(format!(
                "`Upload-Metadata` needs a `filename` of 1 to {LONGEST_FILE_NAME} bytes of UTF-8."
            ))),
        }
    }
}

/// All keys with their values; `None` if the metadata are malformed.
fn pairs(sent: &str) -> Option<HashMap<&str, Vec<u8>>> {
    let mut read = HashMap::new();
    for pair in sent.split(',').filter(|_| !sent.is_empty()) {
        let (key, value) = match pair.trim().split_once(' ') {
            Some((key, value)) => (key, STANDARD.decode(value).ok()?),
            None => (pair.trim(), Vec::new()),
        };
        if key.is_empty() || read.insert(key, value).is_some() {
            return None;
        }
    }
    Some(read)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_needs_a_name_and_other_keys_are_ignored() {
        let of = |sent: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(METADATA, sent.parse().expect("header"));
            Metadata::of(&headers).ok().map(|read| read.filename)
        };
        let named = Some("a.png".to_owned());
        assert_eq!(of("filename YS5wbmc="), named);
        assert_eq!(of("is_confidential,filename YS5wbmc=, filetype "), named);
        let nested = Some("b/a.png".to_owned());
        assert_eq!(of("filename YS5wbmc=,relativePath Yi9hLnBuZw=="), nested);
        assert_eq!(of("relativePath bnVsbA==,filename YS5wbmc="), named);
        for wrong in [
            "",
            "filename",
            "filename ",
            "filetype YS5wbmc=",
            "filename YS5wbmc=,filename YS5wbmc=",
            "filename YS5wbmc=,,a",
            "filename YS5w bmc=",
            "filename ____",
            // 0xff is not UTF-8.
            "filename /w==",
        ] {
            assert_eq!(of(wrong), None, "{wrong}");
        }
        let long = STANDARD.encode("x".repeat(LONGEST_FILE_NAME + 1));
        assert_eq!(of(&format!("filename {long}")), None);
        let long = "x".repeat(LONGEST);
        assert_eq!(of(&format!("filename YS5wbmc=,{long}")), None);
    }
}
