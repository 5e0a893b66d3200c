//! The file of an export: a line that says what there is, a line for each row, and a line with the
//! digest of all before it.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::data::sync_directory;
use crate::error::{Result, ServerError};
use crate::store::{TABLES, Table};

/// What the file says that it is.
const FORMAT: &str = "fled rows 1";

/// The first line.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    format: String,
    /// The version of the program that wrote it.
    program: String,
    schema: i64,
    /// By table, in order.
    pub columns: BTreeMap<String, Vec<String>>,
    /// How many, by table.
    pub rows: BTreeMap<String, u64>,
    /// Rows that are not in it, by table.
    pub left_out: BTreeMap<String, u64>,
}

impl Header {
    /// Of a database of this schema.
    pub fn new(schema: i64) -> Self {
        Self {
            format: FORMAT.to_owned(),
            program: env!("CARGO_PKG_VERSION").to_owned(),
            schema,
            columns: BTreeMap::new(),
            rows: BTreeMap::new(),
            left_out: BTreeMap::new(),
        }
    }

    /// # Errors
    /// [`ServerError::NotMoved`] where it is of another schema.
    pub fn expect_schema(&self, file: &Path, known: i64) -> Result<()> {
        if self.schema == known {
            return Ok(());
        }
        let words = format!(
            "is of schema {}, by fled {}, and this program knows {known}: export and import with \
             the same version",
            self.schema, self.program
        );
        Err(refused(file, &words))
    }

    /// # Errors
    /// [`ServerError::NotMoved`] where the table has other columns.
    pub fn expect_columns(&self, file: &Path, table: &str, known: &[String]) -> Result<()> {
        if self.columns.get(table).is_some_and(|here| here == known) {
            return Ok(());
        }
        let words = format!("has other columns of {table} than the database");
        Err(refused(file, &words))
    }
}

#[derive(Serialize, Deserialize)]
struct End {
    end: String,
}

/// A file that is being written: whole under its name, or not there.
#[derive(Debug)]
pub struct Writer {
    to: PathBuf,
    unfinished: PathBuf,
    out: BufWriter<File>,
    hash: blake3::Hasher,
    rows: u64,
}

impl Writer {
    /// # Errors
    /// When there is such a file, or it cannot be written.
    pub fn begin(to: &Path, header: &Header) -> Result<Self> {
        if to.exists() {
            let error = io::Error::other("there is such a file: give another name");
            return Err(ServerError::io(to)(error));
        }
        let mut unfinished = to.as_os_str().to_owned();
        unfinished.push(".tmp");
        let unfinished = PathBuf::from(unfinished);
        // Secrets of webhooks are in it.
        let file = File::options()
            .write(true)
            .create(true)
            .truncate(true)
            .mode(0o600)
            .open(&unfinished)
            .map_err(ServerError::io(&unfinished))?;
        let mut writer = Self {
            to: to.to_owned(),
            unfinished,
            out: BufWriter::new(file),
            hash: blake3::Hasher::new(),
            rows: 0,
        };
        writer.line(&json!(header))?;
        Ok(writer)
    }

    /// # Errors
    /// When it cannot be written.
    pub fn row(&mut self, table: &str, row: &Map<String, Value>) -> Result<()> {
        self.rows += 1;
        self.line(&json!({ table: row }))
    }

    /// Makes the file whole; how many rows it has.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn end(mut self) -> Result<u64> {
        let end = self.hash.finalize().to_hex().to_string();
        self.line(&json!(End { end }))?;
        self.finish().map_err(ServerError::io(&self.to))?;
        Ok(self.rows)
    }

    fn finish(&mut self) -> io::Result<()> {
        self.out.flush()?;
        self.out.get_ref().sync_all()?;
        fs::rename(&self.unfinished, &self.to)?;
        let folder = self.to.parent().filter(|path| !path.as_os_str().is_empty());
        sync_directory(folder.unwrap_or(Path::new(".")))
    }

    fn line(&mut self, value: &Value) -> Result<()> {
        let line = format!("{value}\n");
        self.hash.update(line.as_bytes());
        let written = self.out.write_all(line.as_bytes());
        written.map_err(ServerError::io(&self.unfinished))
    }
}

/// A file that is being read.
#[derive(Debug)]
pub struct Reader {
    path: PathBuf,
    lines: BufReader<File>,
    hash: blake3::Hasher,
    /// The first line.
    pub header: Header,
    rows: BTreeMap<String, u64>,
    /// Where the last row's table stands among the tables.
    at: usize,
}

impl Reader {
    /// # Errors
    /// When it cannot be read, or is none.
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(ServerError::io(path))?;
        let mut lines = BufReader::new(file);
        let mut first = String::new();
        let not_one = || refused(path, "is no file that `fled db export` has written");
        lines.read_line(&mut first).map_err(|error| match error {
            error if error.kind() == io::ErrorKind::InvalidData => not_one(),
            error => ServerError::io(path)(error),
        })?;
        let header: Header = serde_json::from_str(&first).map_err(|_| not_one())?;
        if header.format != FORMAT {
            return Err(not_one());
        }
        let mut hash = blake3::Hasher::new();
        hash.update(first.as_bytes());
        Ok(Self {
            path: path.to_owned(),
            lines,
            hash,
            header,
            rows: BTreeMap::new(),
            at: 0,
        })
    }

    /// The next row and its table; `None` once all of them were there, as they were written.
    ///
    /// # Errors
    /// [`ServerError::NotMoved`] where the file is not what was written.
    pub fn next_row(&mut self) -> Result<Option<(&'static Table, Map<String, Value>)>> {
        let mut line = Vec::new();
        let read = self.lines.read_until(b'\n', &mut line);
        read.map_err(ServerError::io(&self.path))?;
        if line.last() != Some(&b'\n') {
            return Err(refused(
                &self.path,
                "is cut off: its last line is missing. Copy it again as a whole, or export again",
            ));
        }
        let value: Map<String, Value> =
            serde_json::from_slice(&line).map_err(|_| altered(&self.path))?;
        let Some((name, row)) = value.into_iter().next() else {
            return Err(altered(&self.path));
        };
        if let ("end", Value::String(digest)) = (name.as_str(), &row) {
            return self.end(digest).map(|()| None);
        }
        self.hash.update(&line);
        // No table comes again: none of its rows could name what came after them.
        let at = TABLES[self.at..]
            .iter()
            .position(|table| table.name == name);
        let (Some(at), Value::Object(row)) = (at, row) else {
            return Err(altered(&self.path));
        };
        self.at += at;
        let columns = self.header.columns.get(&name);
        let is_whole = columns.is_some_and(|columns| {
            columns.len() == row.len() && columns.iter().all(|column| row.contains_key(column))
        });
        if !is_whole {
            return Err(altered(&self.path));
        }
        *self.rows.entry(name).or_default() += 1;
        Ok(Some((&TABLES[self.at], row)))
    }

    fn end(&mut self, digest: &str) -> Result<()> {
        let counted = |(table, rows): (&String, &u64)| {
            self.rows.get(table).copied().unwrap_or_default() == *rows
        };
        let mut rest = [0];
        let rest = io::Read::read(&mut self.lines, &mut rest);
        let rest = rest.map_err(ServerError::io(&self.path))?;
        let is_whole = self.hash.finalize().to_hex().as_str() == digest
            && self.header.rows.iter().all(counted)
            && rest == 0;
        if is_whole {
            return Ok(());
        }
        Err(altered(&self.path))
    }
}

fn altered(path: &Path) -> ServerError {
    let words = "is damaged: it is not what was written. Copy it again, or export again";
    refused(path, words)
}

fn refused(path: &Path, words: &str) -> ServerError {
    ServerError::NotMoved(format!("{} {words}", path.display()))
}
