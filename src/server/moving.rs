//! From one installation to another, of the other database: all rows as a file of lines, and the
//! files that lie in the data directory into a store of files.
//!
//! Nothing works on either meanwhile. What is read is checked as a whole before anything is
//! changed, files are put into the store before a row names them, and the rows come in one
//! transaction: whatever breaks off leaves an empty database and may be done again.

mod file;
mod files;

use std::path::{Path, PathBuf};

use fled_blobs::Blobs;
use serde_json::Value;

use crate::collector;
use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::store::{Engine, Intake, Snapshot, Store, TABLES, Table};
use file::{Header, Reader, Writer};
use files::{Survey, keep};

/// Rows that are inserted at once.
const ROWS: usize = 500;

/// A worker that was heard of so lately still works, milliseconds.
const STILL_THERE_MS: i64 = 60_000;

/// What an export came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Exported {
    /// Rows.
    pub rows: u64,
    /// Uploads of which no capture is made yet: they do not move.
    pub uploads: u64,
}

/// What an import came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Imported {
    /// Rows.
    pub rows: u64,
    /// Files that were put into the store, or were there already.
    pub files: usize,
    /// Bytes of them.
    pub bytes: u64,
    /// Jobs that ran when their server ended, and wait now.
    pub released: usize,
    /// Videos that were not finished: they do not move.
    pub videos: usize,
}

/// Where an import comes from, and where it goes.
#[derive(Clone, Debug)]
pub struct Import {
    /// What an export wrote.
    pub file: PathBuf,
    /// The data directory that it was made of, where its files lie there.
    pub data: Option<PathBuf>,
    /// The new database, which has no rows.
    pub database: String,
    /// The store of files.
    pub files: String,
}

/// Says in a store of files that it belongs to the database in the data directory, or to
/// `database`: what that does not name is deleted there. Servers may work meanwhile. Returns where
/// the store is.
///
/// # Errors
/// When the database or the store refuses.
pub async fn own(data: &Path, database: Option<&str>, files: &str) -> Result<String> {
    let store = match database {
        Some(url) if !url.starts_with("sqlite:") => Store::at_as_it_is(url).await?,
        database => {
            let path = database.and_then(|url| url.strip_prefix("sqlite:"));
            let path = path.map_or_else(|| data.join("fled.db"), PathBuf::from);
            Store::as_it_is(&path).await?
        }
    };
    store.check_version().await?;
    let blobs = Blobs::open(files)?;
    collector::own(&store, &blobs).await?;
    store.close().await;
    Ok(blobs.location().to_owned())
}

/// Writes all rows of the database in the data directory, or of `database`, to the file `to`, which
/// must not be there. It has secrets in it, and nobody else may read it.
///
/// # Errors
/// [`ServerError::DataInUse`] while a server works there, [`ServerError::NotMoved`] while workers
/// do; when something cannot be read or written.
pub async fn export(data: &Path, database: Option<&str>, to: &Path) -> Result<Exported> {
    let (_held, store) = match database {
        Some(url) if !url.starts_with("sqlite:") => (None, Store::at_as_it_is(url).await?),
        database => {
            let held = hold(data)?;
            let path = database.and_then(|url| url.strip_prefix("sqlite:"));
            let path = path.map_or_else(|| held.database(), PathBuf::from);
            (Some(held), Store::as_it_is(&path).await?)
        }
    };
    store.check_version().await?;
    if store.engine() == Engine::Postgres {
        nobody_works(&store).await?;
    }
    let mut snapshot = store.snapshot().await?;
    let header = header(&mut snapshot, &store).await?;
    let uploads = header.left_out.values().sum();
    let mut writer = Writer::begin(to, &header)?;
    for table in TABLES.iter().filter(|table| table.moves) {
        snapshot
            .each(table, |row| writer.row(table.name, &row))
            .await?;
    }
    drop(snapshot);
    store.close().await;
    let rows = writer.end()?;
    Ok(Exported { rows, uploads })
}

/// Takes the lock of a data directory.
fn hold(data: &Path) -> Result<DataDir> {
    let held = DataDir::beside(data)?;
    if held.is_ours() {
        Ok(held)
    } else {
        Err(ServerError::DataInUse(data.to_owned()))
    }
}

async fn nobody_works(store: &Store) -> Result<()> {
    let now = store.now().await?;
    for worker in store.workers().await? {
        if now - worker.seen_at < STILL_THERE_MS {
            return Err(ServerError::NotMoved(format!(
                "worker {} on {} still works on this database: stop all servers and workers first",
                worker.id, worker.about.host
            )));
        }
    }
    Ok(())
}

async fn header(snapshot: &mut Snapshot, store: &Store) -> Result<Header> {
    let mut header = Header::new(store.schema());
    for table in &TABLES {
        let (name, count) = (table.name.to_owned(), snapshot.count(table).await?);
        if table.moves {
            let columns = snapshot.columns(table).await?;
            header.columns.insert(name.clone(), columns);
            header.rows.insert(name, count);
        } else {
            header.left_out.insert(name, count);
        }
    }
    Ok(header)
}

/// Brings what an export wrote into a database without rows, and its files into a store of files.
///
/// # Errors
/// [`ServerError::NotMoved`] where the file is damaged or of another schema, where the database
/// has rows, and where files are missing; when something cannot be read or written. The database
/// has no rows then.
pub async fn import(import: &Import) -> Result<Imported> {
    let survey = Survey::of(&import.file)?;
    let held = import.data.as_deref().map(hold).transpose()?;
    let store = Store::at(&import.database).await?;
    survey.header.expect_schema(&import.file, store.schema())?;
    if let Some(table) = store.has_rows().await? {
        return Err(not_empty(table));
    }
    let blobs = Blobs::open(&import.files)?;
    blobs.check().await?;
    let kept = keep(&survey, &blobs, held.as_ref()).await?;
    let mut intake = store.take_in().await?.map_err(not_empty)?;
    let rows = take_rows(&mut intake, &import.file).await?;
    let mut done = Imported {
        rows,
        videos: kept.videos,
        ..Imported::default()
    };
    for (id, files) in &kept.captures {
        intake.name_of_capture(id, files).await?;
    }
    for (id, files) in &kept.jobs {
        intake.name_of_job(id, files).await?;
    }
    for file in kept.captures.iter().chain(&kept.jobs).flat_map(|of| &of.1) {
        done.files += 1;
        done.bytes += file.blob.bytes;
    }
    done.released = intake.finish().await?;
    store.close().await;
    Ok(done)
}

fn not_empty(table: &str) -> ServerError {
    ServerError::NotMoved(format!(
        "the database has rows in its table {table} already: give an empty one"
    ))
}

/// Inserts every row of a file, and sees that all of it has come.
async fn take_rows(intake: &mut Intake, file: &Path) -> Result<u64> {
    let mut reader = Reader::open(file)?;
    for table in TABLES.iter().filter(|table| table.moves) {
        let columns = intake.columns(table).await?;
        reader.header.expect_columns(file, table.name, &columns)?;
    }
    let mut waiting: Vec<Value> = Vec::new();
    let mut of: Option<&Table> = None;
    let mut rows = 0;
    while let Some((table, row)) = reader.next_row()? {
        if let Some(of) = of.filter(|of| of.name != table.name || waiting.len() == ROWS) {
            intake.insert(of, &waiting).await?;
            waiting.clear();
        }
        of = Some(table);
        waiting.push(Value::Object(row));
        rows += 1;
    }
    if let Some(of) = of {
        intake.insert(of, &waiting).await?;
    }
    Ok(rows)
}
