//! The photographs of an earlier capture, for one that adds to them.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};

use fled_core::capture::write_unpacked;

use super::budget::Budget;
use super::gather::link;
use super::places::{PHOTOGRAPHS, Places};
use crate::app::App;
use crate::error::ServerError;
use crate::files::data;
use crate::http::access::Visitor;
use crate::http::jobs::seen_capture;
use crate::http::problem::{Problem, disk_full};
use crate::http::shapes::report;
use crate::sharing::fetch_photographs;
use crate::validation::source;

/// The photographs of a capture that are used.
#[derive(Debug)]
pub(super) struct Earlier {
    folder: PathBuf,
    /// Their paths as sent.
    pub names: Vec<String>,
}

impl Earlier {
    /// Those of a capture that the visitor may use.
    ///
    /// # Errors
    /// 404 if it does not exist or has another owner; when the database or a store fails.
    pub async fn of(app: &App, id: &str, visitor: &Visitor) -> Result<Self, Problem> {
        let row = seen_capture(app, id, visitor).await?;
        let row = row.ok_or_else(|| Problem::not_found("capture").pointer("/add_to"))?;
        fetch_photographs(app, &row.id).await?;
        let accepted = report(&row).images.into_iter().filter(|image| image.accepted);
        let names = accepted.map(|image| image.name).collect();
        Ok(Self { folder: app.data.capture(&row.id), names })
    }

    /// Puts them into `dir`, at free places, and counts their bytes.
    ///
    /// # Errors
    /// 404 if one is gone; those of [`Budget::count`]; 507 if the disk is full.
    pub fn link_into(
        &self,
        dir: &Path,
        places: &mut Places,
        budget: &mut Budget<'_>,
    ) -> Result<(), Problem> {
        let app = budget.app;
        let mut count = |bytes| budget.count(bytes).map_err(|problem| problem.pointer("/add_to"));
        let stored = source(self.folder.clone());
        for name in &self.names {
            let from = data::photograph(&self.folder, name)
                .ok_or_else(|| Problem::not_found("photograph").pointer("/add_to"))?;
            let to = dir.join(places.place(PHOTOGRAPHS, name)?);
            if stored == self.folder {
                let from = self.folder.join(from);
                let bytes = fs::metadata(&from).map_err(ServerError::io(&from))?.len();
                count(bytes)?;
                if link(&from, &to).is_err() {
                    // The file system has no hard links.
                    if app.has_no_space_for(bytes) {
                        return Err(disk_full());
                    }
                    fs::copy(&from, &to).map_err(|error| failed(app, &to, error))?;
                }
                continue;
            }
            let bytes = unpack(&stored, &from, &to).map_err(|error| failed(app, &to, error))?;
            count(bytes)?;
        }
        Ok(())
    }
}

/// Unpacks one file of a ZIP and returns its bytes.
fn unpack(archive: &Path, file: &Path, to: &Path) -> io::Result<u64> {
    if let Some(folder) = to.parent() {
        fs::create_dir_all(folder)?;
    }
    let mut out = BufWriter::new(File::create(to)?);
    write_unpacked(archive, file, &mut out).map_err(io::Error::other)?;
    out.flush()?;
    out.get_ref().metadata().map(|about| about.len())
}

fn failed(app: &App, to: &Path, error: io::Error) -> Problem {
    if app.has_no_space_for(0) { disk_full() } else { ServerError::io(to)(error).into() }
}
