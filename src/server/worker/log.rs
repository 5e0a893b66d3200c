//! A job's log: bounded, appended to by its worker, read in pages.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;

/// Appends timestamped lines until the log is full.
#[derive(Debug)]
pub struct LogWriter {
    file: File,
    left: u64,
}

impl LogWriter {
    /// Opens the log for appending.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn open(path: &Path, max_bytes: u64) -> io::Result<Self> {
        let file = File::options().create(true).append(true).open(path)?;
        let left = max_bytes.saturating_sub(file.metadata()?.len());
        Ok(Self { file, left })
    }

    /// Appends one line unless the log is full. A log that cannot be written does not stop a job.
    pub fn line(&mut self, text: &str) {
        if self.left == 0 {
            return;
        }
        let mut line = format!("{:.0} {text}\n", jiff::Timestamp::now());
        if line.len() as u64 >= self.left {
            self.left = 0;
            "The log is full; later lines are dropped.\n".clone_into(&mut line);
        } else {
            self.left -= line.len() as u64;
        }
        if let Err(error) = self.file.write_all(line.as_bytes()) {
            tracing::warn!(%error, "cannot write a job's log");
        }
    }
}

/// A page of a log.
#[derive(Debug, PartialEq, Eq)]
pub struct Page {
    /// Complete lines.
    pub lines: Vec<String>,
    /// Offset of the next page, in bytes.
    pub next_offset: u64,
    /// Whether nothing more is available for now.
    pub end: bool,
}

/// Reads at most `limit` complete lines starting at `offset` bytes. A log that does not exist yet
/// is empty, and an offset past the end reads nothing.
///
/// # Errors
/// When the log cannot be read.
pub fn read_page(path: &Path, offset: u64, limit: usize) -> io::Result<Page> {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Ok(Page { lines: Vec::new(), next_offset: 0, end: true });
        }
        Err(error) => return Err(error),
    };
    // File systems refuse to seek to very large offsets.
    let offset = offset.min(file.metadata()?.len());
    file.seek(SeekFrom::Start(offset))?;
    let mut reader = BufReader::new(file);
    let mut page = Page { lines: Vec::new(), next_offset: offset, end: false };
    let mut bytes = Vec::new();
    while page.lines.len() < limit {
        bytes.clear();
        reader.read_until(b'\n', &mut bytes)?;
        // A line without its newline is still being written.
        if bytes.last() != Some(&b'\n') {
            page.end = true;
            break;
        }
        page.next_offset += bytes.len() as u64;
        page.lines.push(String::from_utf8_lossy(&bytes).trim_end_matches(['\n', '\r']).to_owned());
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_join_without_gaps_and_skip_an_unfinished_line() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let path = dir.path().join("log.txt");
        assert!(read_page(&path, 0, 5).expect("no log yet").end);
        std::fs::write(&path, "one\ntwo\nthree\nfo").expect("write");
        let first = read_page(&path, 0, 2).expect("page");
        assert_eq!(
            (first.lines.as_slice(), first.end),
            (["one".to_owned(), "two".to_owned()].as_slice(), false)
        );
        let second = read_page(&path, first.next_offset, 2).expect("page");
        assert_eq!((second.lines.as_slice(), second.end), (["three".to_owned()].as_slice(), true));
        std::fs::write(&path, "one\ntwo\nthree\nfour\n").expect("write");
        assert_eq!(read_page(&path, second.next_offset, 2).expect("page").lines, ["four"]);
    }

    #[test]
    fn a_log_never_grows_beyond_its_bound() {
        let dir = tempfile::tempdir().expect("temporary directory");
        let path = dir.path().join("log.txt");
        for _ in 0..3 {
            let mut log = LogWriter::open(&path, 300).expect("open");
            (0..50).for_each(|i| log.line(&format!("line {i}")));
        }
        let text = std::fs::read_to_string(&path).expect("read");
        assert!(text.len() < 400 && text.contains("The log is full"), "{}", text.len());
    }
}
