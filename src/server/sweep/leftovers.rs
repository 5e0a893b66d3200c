//! What lies in a data directory and is not wanted any more: one list of rules for all who look.

use std::collections::HashSet;
use std::fs::{self, DirEntry, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::data::DataDir;
use crate::error::{Result, ServerError};
use crate::store::Store;

/// The ids of what has a row.
#[derive(Debug)]
pub struct Named {
    /// Captures.
    pub captures: HashSet<String>,
    /// Jobs.
    pub jobs: HashSet<String>,
    /// Uploads in pieces.
    pub uploads: HashSet<String>,
}

impl Named {
    /// What has a row now.
    ///
    /// # Errors
    /// When the database refuses.
    pub async fn in_store(store: &Store) -> Result<Self> {
        Ok(Self {
            captures: store.ids("captures").await?,
            jobs: store.ids("jobs").await?,
            uploads: store.ids("uploads").await?,
        })
    }
}

/// How long things stay.
#[derive(Clone, Copy, Debug)]
pub struct Ages {
    /// Whatever has changed within this stays: what is being made has no row yet.
    pub made: Duration,
    /// What was moved aside.
    pub unnamed: Duration,
    /// Poses that were found; they are found again when they are wanted.
    pub poses: Duration,
    /// Novel views, which are rendered again; `None` keeps them.
    pub renders: Option<Duration>,
}

/// Why something goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// The database does not name it: it is moved aside.
    Unnamed,
    /// It was moved aside long ago.
    Aside,
    /// An upload that came to nothing, or half a picture.
    Unfinished,
    /// A capture has it, or nothing came of it.
    Spare,
    /// Poses that were found long ago.
    Poses,
    /// A novel view that was rendered long ago.
    Render,
}

/// What goes from one folder, and how.
pub struct Rule<'a> {
    dir: PathBuf,
    age: Duration,
    is_left: Box<dyn Fn(&DirEntry) -> bool + 'a>,
    /// Where it is moved; it is removed when there is no such place.
    aside: Option<PathBuf>,
    /// Why it goes.
    pub why: Why,
}

/// The rules, in the order in which they are to be followed; `uses` says which folders of uploads
/// are in use, where that is known.
pub fn rules<'a>(
    data: &DataDir,
    rows: &'a Named,
    ages: Ages,
    uses: Option<&'a dyn Fn(&Path) -> bool>,
) -> Vec<Rule<'a>> {
    let named = |ids: &HashSet<String>, entry: &DirEntry| {
        let name = entry.file_name();
        name.to_str().is_some_and(|name| ids.contains(name))
    };
    let mut rules = Vec::new();
    // Of an upload that is empty nothing is lost, nor of one whose bytes a capture has: by a second
    // name of the same file.
    let is_spare = move |entry: &DirEntry| {
        let is_spare = |about: Metadata| about.len() == 0 || about.nlink() > 1;
        !named(&rows.uploads, entry) && entry.metadata().is_ok_and(is_spare)
    };
    rules.push(removed(data.uploads(), ages.made, Why::Spare, is_spare));
    for (from, ids) in [
        (data.captures(), &rows.captures),
        (data.jobs(), &rows.jobs),
        (data.uploads(), &rows.uploads),
    ] {
        let aside = data.unnamed(&from);
        let age = ages.made.max(ages.unnamed);
        rules.push(removed(aside.clone(), age, Why::Aside, |_| true));
        rules.push(Rule {
            dir: from,
            age: ages.made,
            is_left: Box::new(move |entry| !named(ids, entry)),
            aside: Some(aside),
            why: Why::Unnamed,
        });
    }
    if let Some(uses) = uses {
        let is_left = move |entry: &DirEntry| !uses(&entry.path());
        rules.push(removed(
            data.incoming(),
            ages.made,
            Why::Unfinished,
            is_left,
        ));
    }
    let age = ages.made.max(ages.poses);
    rules.push(removed(data.cache(), age, Why::Poses, |_| true));
    for id in &rows.jobs {
        let half = |entry: &DirEntry| entry.path().extension().is_some_and(|end| end == "tmp");
        rules.push(removed(data.renders(id), ages.made, Why::Unfinished, half));
        if let Some(age) = ages.renders {
            let age = ages.made.max(age);
            rules.push(removed(data.renders(id), age, Why::Render, |_| true));
        }
    }
    rules
}

fn removed<'a>(
    dir: PathBuf,
    age: Duration,
    why: Why,
    is_left: impl Fn(&DirEntry) -> bool + 'a,
) -> Rule<'a> {
    Rule {
        dir,
        age,
        is_left: Box::new(is_left),
        aside: None,
        why,
    }
}

impl Rule<'_> {
    /// What goes by this rule.
    ///
    /// # Errors
    /// When the folder cannot be read; one that is not there holds nothing.
    pub fn find(&self) -> Result<Vec<PathBuf>> {
        let entries = match fs::read_dir(&self.dir) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(ServerError::io(&self.dir))?,
        };
        let mut left = Vec::new();
        for entry in entries {
            let entry = entry.map_err(ServerError::io(&self.dir))?;
            let Ok(metadata) = entry.metadata() else {
                // It went meanwhile.
                continue;
            };
            if !changed_within(&metadata, self.age) && (self.is_left)(&entry) {
                left.push(entry.path());
            }
        }
        Ok(left)
    }

    /// Removes it or moves it aside, where nothing is lost that is there already. Whether it went:
    /// what cannot be removed is told in the log.
    ///
    /// # Errors
    /// When there is no folder to move it to.
    pub fn follow(&self, path: &Path) -> Result<bool> {
        let gone = match &self.aside {
            Some(aside) => {
                fs::create_dir_all(aside).map_err(ServerError::io(aside))?;
                let to = free_name(aside, path);
                fs::rename(path, &to).inspect(|()| tell_moved(path, &to))
            }
            None => remove(path).inspect(|()| {
                tracing::info!(path = %path.display(), why = ?self.why, "removed");
            }),
        };
        if let Err(error) = &gone {
            tracing::warn!(%error, path = %path.display(), "cannot be removed or moved aside");
        }
        Ok(gone.is_ok())
    }

    /// Follows the rule. How many things went.
    ///
    /// # Errors
    /// Those of [`Rule::find`] and [`Rule::follow`].
    pub fn follow_all(&self) -> Result<usize> {
        let mut gone = 0;
        for path in self.find()? {
            gone += usize::from(self.follow(&path)?);
        }
        Ok(gone)
    }
}

fn tell_moved(from: &Path, to: &Path) {
    tracing::warn!(
        from = %from.display(),
        to = %to.display(),
        "moved aside for 30 days: the database does not name it. If the database is an older copy, \
         stop the server, put the right one in place and move this back; photographs can also be \
         uploaded again from here"
    );
}

fn remove(path: &Path) -> io::Result<()> {
    if fs::symlink_metadata(path)?.is_dir() {
        fs::remove_dir_all(path)
    } else {
        fs::remove_file(path)
    }
}

/// A name in `aside` that nothing has.
fn free_name(aside: &Path, path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default();
    let mut to = aside.join(name);
    for copy in 2.. {
        if !to.exists() {
            break;
        }
        to = aside.join(name).with_added_extension(copy.to_string());
    }
    to
}

/// Whether something was written or moved here within `age`.
fn changed_within(metadata: &Metadata, age: Duration) -> bool {
    let changed = UNIX_EPOCH + Duration::from_secs(u64::try_from(metadata.ctime()).unwrap_or(0));
    // A clock that was set back makes things young, and they stay.
    let old = SystemTime::now()
        .duration_since(changed)
        .unwrap_or_default();
    old < age
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_has_not_changed_for_long_and_is_not_wanted_goes() {
        let dir = tempfile::tempdir().expect("temporary directory");
        for name in ["left", "named"] {
            fs::create_dir(dir.path().join(name)).expect("made");
        }
        fs::write(dir.path().join("file.json"), "{}").expect("written");
        let aside = dir.path().join("aside");
        let rule = |dir: PathBuf, hours: u64, aside: Option<&PathBuf>| Rule {
            dir,
            age: Duration::from_secs(hours * 3600),
            is_left: Box::new(|entry| entry.file_name() != "named"),
            aside: aside.cloned(),
            why: Why::Spare,
        };
        let here = |hours| rule(dir.path().to_owned(), hours, None);
        assert_eq!(here(1).follow_all().expect("swept"), 0);
        assert_eq!(here(0).follow_all().expect("swept"), 2);
        assert!(dir.path().join("named").exists());
        let place = dir.path().join("named");
        for _ in 0..2 {
            fs::create_dir(place.join("lost")).expect("made");
            let moved = |hours| rule(place.clone(), hours, Some(&aside));
            assert_eq!(moved(1).follow_all().expect("swept"), 0);
            assert_eq!(moved(0).follow_all().expect("swept"), 1);
        }
        assert!(aside.join("lost").exists() && aside.join("lost.2").exists());
        let missing = rule(dir.path().join("missing"), 0, None);
        assert_eq!(missing.follow_all().expect("nothing"), 0);
    }
}
