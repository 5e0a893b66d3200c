//! A multipart body of files, read while it is sent.

use std::fs::File;
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};

use crate::failure::{Failure, io as at};

/// The boundary between parts, long and unusual enough to occur in no photograph.
const BOUNDARY: &str = "fled-7Qm2w9kX4tR8vB1nL5cZ-of-parts";

/// A form of text fields, then files as parts named `images`.
pub struct Form {
    parts: Vec<(Vec<u8>, Option<PathBuf>)>,
    bytes: u64,
    /// Equal for equal names and contents.
    pub digest: blake3::Hash,
}

impl Form {
    /// A form for a folder, with all files that are not hidden, or for one file, such as a ZIP.
    ///
    /// # Errors
    /// [`Failure`] if a file cannot be read.
    pub fn new(fields: &[(&str, String)], capture: &Path) -> Result<Self, Failure> {
        let mut form = Self { parts: Vec::new(), bytes: 0, digest: blake3::hash(b"") };
        let mut hasher = blake3::Hasher::new();
        for (name, value) in fields {
            let head = format!("form-data; name=\"{name}\"");
            form.push(&mut hasher, &format!("{head}\r\n\r\n{value}"), None)?;
        }
        for (name, path) in files(capture)? {
            // Browsers escape names in this header the same way.
            let name = name.replace('"', "%22").replace('\r', "%0D").replace('\n', "%0A");
            let head = format!("form-data; name=\"images\"; filename=\"{name}\"\r\n");
            let head = format!("{head}Content-Type: application/octet-stream\r\n\r\n");
            form.push(&mut hasher, &head, Some(path))?;
        }
        let end = format!("\r\n--{BOUNDARY}--\r\n").into_bytes();
        form.bytes += end.len() as u64;
        form.parts.push((end, None));
        form.digest = hasher.finalize();
        Ok(form)
    }

    fn push(
        &mut self,
        hasher: &mut blake3::Hasher,
        head: &str,
        path: Option<PathBuf>,
    ) -> Result<(), Failure> {
        let start = if self.parts.is_empty() { "" } else { "\r\n" };
        let head = format!("{start}--{BOUNDARY}\r\nContent-Disposition: {head}").into_bytes();
        hasher.update(&head);
        self.bytes += head.len() as u64;
        if let Some(path) = &path {
            let mut file = File::open(path).map_err(at(path))?;
            self.bytes += file.metadata().map_err(at(path))?.len();
            hasher.update_reader(&mut file).map_err(at(path))?;
        }
        self.parts.push((head, path));
        Ok(())
    }

    /// Bytes of the whole body.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The header with the boundary.
    pub fn content_type() -> String {
        format!("multipart/form-data; boundary={BOUNDARY}")
    }

    /// The body from the start.
    pub fn body(&self) -> impl Read + '_ {
        FormBody { parts: self.parts.iter(), now: Box::new(io::empty()) }
    }
}

struct FormBody<'a> {
    parts: std::slice::Iter<'a, (Vec<u8>, Option<PathBuf>)>,
    now: Box<dyn Read + 'a>,
}

impl Read for FormBody<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let read = self.now.read(buffer)?;
            if read > 0 || buffer.is_empty() {
                return Ok(read);
            }
            let Some((head, path)) = self.parts.next() else {
                return Ok(0);
            };
            let head = Cursor::new(head);
            self.now = match path {
                Some(path) => Box::new(head.chain(File::open(path)?)),
                None => Box::new(head),
            };
        }
    }
}

/// The files of a capture with their names, sorted.
fn files(capture: &Path) -> Result<Vec<(String, PathBuf)>, Failure> {
    if capture.is_file() {
        let name = capture.file_name().unwrap_or_default().to_string_lossy();
        return Ok(vec![(name.into_owned(), capture.to_owned())]);
    }
    let mut found = Vec::new();
    below(capture, "", &mut found)?;
    found.sort();
    if found.is_empty() {
        let detail = format!("{} has no files", capture.display());
        return Err(Failure::usage(detail));
    }
    Ok(found)
}

fn below(folder: &Path, prefix: &str, found: &mut Vec<(String, PathBuf)>) -> Result<(), Failure> {
    for entry in std::fs::read_dir(folder).map_err(at(folder))? {
        let path = entry.map_err(at(folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with('.') {
            continue;
        }
        let name = format!("{prefix}{name}");
        if path.is_dir() {
            below(&path, &format!("{name}/"), found)?;
        } else {
            found.push((name, path));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_has_its_announced_length_and_all_files() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let root = folder.path();
        std::fs::create_dir(root.join("gt")).expect("a folder");
        for (name, content) in [("b.png", "22"), ("gt/b.png", "333"), (".hidden", "no")] {
            std::fs::write(root.join(name), content).expect("written");
        }
        let fields = [("name", "a place".to_owned())];
        let form = Form::new(&fields, root).expect("a form");
        let mut body = String::new();
        form.body().read_to_string(&mut body).expect("read");
        assert_eq!(body.len() as u64, form.bytes());
        let parts: Vec<&str> = body.split(BOUNDARY).collect();
        assert_eq!(parts.len(), 5, "{body}");
        assert!(parts[1].ends_with("name=\"name\"\r\n\r\na place\r\n--"));
        assert!(parts[2].contains("filename=\"b.png\"") && parts[2].ends_with("\r\n\r\n22\r\n--"));
        assert!(parts[3].contains("filename=\"gt/b.png\""));
        assert!(!body.contains("hidden") && body.ends_with("--\r\n"));
        let same = Form::new(&fields, root).expect("a form");
        assert_eq!(form.digest, same.digest);
        std::fs::write(root.join("b.png"), "23").expect("written");
        let other = Form::new(&fields, root).expect("a form");
        assert_ne!(form.digest, other.digest);
    }
}
