//! Putting a network into a folder of models, so that it can be chosen by its name.

use std::fs::File;
use std::path::{Path, PathBuf};

use crate::deblur::manifest::{Entry, Manifest, OVERLAY, digest};
use crate::deblur::{DeblurError, Golden};
use crate::image::write_atomic;

/// Puts the network's file `content`, its golden output and its entry into `directory`. The entry
/// comes last and whole, and a network that it replaces stays usable until then: what differs gets
/// a name of its own, and the old file goes after the entry. One call at a time in a folder,
/// processes included.
///
/// # Errors
/// [`DeblurError::ModelNotKept`], also for an entry that cannot be listed or whose file would take
/// the place of another network's; [`DeblurError::ManifestUnreadable`] when the overlay that is
/// there is damaged.
pub fn install(
    directory: &Path,
    mut entry: Entry,
    content: &[u8],
    golden: &Golden,
) -> Result<(), DeblurError> {
    std::fs::create_dir_all(directory).map_err(kept(directory))?;
    let guard = directory.join(".lock");
    let lock = File::create(&guard)
        .and_then(|file| file.lock().map(|()| file))
        .map_err(kept(&guard))?;
    let mut overlay = Manifest::overlay(directory)?;
    let golden = golden.to_bytes();
    let before = overlay.find(&entry.id).cloned();
    let (file, expected) = names(directory, &entry, before.as_ref(), content, &golden);
    (entry.file, entry.golden) = (Some(file.clone()), Some(expected.clone()));
    let refused = |detail: String| kept(&directory.join(&file))(std::io::Error::other(detail));
    entry.check().map_err(&refused)?;
    let mut known = Manifest::known(&[directory.to_path_buf()])?;
    let taken =
        |other: &&Entry| other.id != entry.id && (other.owns(&file) || other.owns(&expected));
    if let Some(other) = known.models.iter().find(taken) {
        return Err(refused(format!(
            "the file is that of network {}; choose another --id",
            other.id
        )));
    }
    overlay.lay_over(entry.clone());
    let mut text = serde_json::to_string_pretty(&overlay).expect("strings, numbers and lists");
    text.push('\n');
    let written = write(&directory.join(&file), content)
        .and_then(|()| write(&directory.join(&expected), &golden))
        .and_then(|()| write(&directory.join(OVERLAY), text.as_bytes()));
    let left = if written.is_ok() {
        known.lay_over(entry);
        before
            .into_iter()
            .flat_map(|entry| [entry.file, entry.golden])
            .flatten()
            .collect()
    } else {
        vec![file, expected]
    };
    for name in left
        .iter()
        .filter(|name| !known.models.iter().any(|entry| entry.owns(name)))
    {
        // What cannot be removed, or was left by a crash, is listed nowhere.
        let _ = std::fs::remove_file(directory.join(name));
    }
    drop(lock);
    written
}

/// The names of the network's file and of its golden output: nothing is written over that `before`,
/// if it can be used, reads.
fn names(
    directory: &Path,
    entry: &Entry,
    before: Option<&Entry>,
    content: &[u8],
    golden: &[u8],
) -> (String, String) {
    let usable =
        before.and_then(|entry| Some((entry, entry.load(&[directory.to_path_buf()]).ok()?)));
    let (file, expected) = if let Some((before, usable)) = usable {
        let named =
            |content: &[u8], kind| Some(format!("{}-{}.{kind}", entry.id, &digest(content)[..8]));
        let same = usable.bytes == content;
        let file = if same {
            before.file.clone()
        } else {
            named(content, "onnx")
        };
        let same = usable
            .golden
            .is_some_and(|known| known.to_bytes() == golden);
        (
            file,
            if same {
                before.golden.clone()
            } else {
                named(golden, "golden")
            },
        )
    } else {
        (entry.file.clone(), entry.golden.clone())
    };
    let plain = |kind| format!("{}.{kind}", entry.id);
    (
        file.unwrap_or_else(|| plain("onnx")),
        expected.unwrap_or_else(|| plain("golden")),
    )
}

impl Manifest {
    /// What `ask` makes of the known networks. One that is replaced after its entry was read is no
    /// longer where that said, so what fails is asked again if the list has changed meanwhile.
    ///
    /// # Errors
    /// [`DeblurError::ManifestUnreadable`]; inside, those of `ask`.
    pub fn ask<T, E>(
        directories: &[PathBuf],
        ask: impl Fn(&Self) -> Result<T, E>,
    ) -> Result<Result<T, E>, DeblurError> {
        let mut known = Self::known(directories)?;
        loop {
            let answer = ask(&known);
            if answer.is_ok() {
                return Ok(answer);
            }
            let now = Self::known(directories)?;
            if now == known {
                return Ok(answer);
            }
            known = now;
        }
    }
}

fn write(path: &Path, content: &[u8]) -> Result<(), DeblurError> {
    write_atomic(path, content).map_err(kept(path))
}

fn kept(path: &Path) -> impl FnOnce(std::io::Error) -> DeblurError {
    let path: PathBuf = path.to_path_buf();
    move |source| DeblurError::ModelNotKept { path, source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::deblur::golden;
    use crate::deblur::manifest::Place;

    #[test]
    fn an_installed_network_is_found_by_its_id_and_the_others_stay() {
        let home = tempfile::tempdir().expect("temporary directory");
        let directory = home.path().join("fled/models");
        let golden = Golden::new(golden::view().data().to_vec()).expect("of the right size");
        let entry = |id: &str| Entry::of_file(id, 3, digest(b"content"), 7);
        install(&directory, entry("first"), b"content", &golden).expect("new folder");
        install(&directory, entry("second"), b"content", &golden).expect("second entry");
        let folders = [directory.clone()];
        let known = Manifest::known(&folders).expect("readable");
        for id in ["first", "second"] {
            let model = known.resolve(id, &folders).expect("installed");
            assert_eq!(
                (model.bytes.as_slice(), model.golden.as_ref()),
                (b"content".as_slice(), Some(&golden))
            );
            let place = known.find(id).expect("listed").place(&folders);
            assert_eq!(place, Place::File(directory.join(format!("{id}.onnx"))));
        }
        std::fs::write(directory.join("first.onnx"), "other").expect("write");
        assert!(matches!(
            known.resolve("first", &folders),
            Err(DeblurError::ModelChecksum { .. })
        ));
        assert!(known.resolve("second", &folders).is_ok());
    }

    /// A folder of networks in which `mine` is replaced.
    struct Mine {
        home: tempfile::TempDir,
    }

    impl Mine {
        fn new() -> Self {
            let home = tempfile::tempdir().expect("temporary directory");
            Self { home }
        }

        fn take(&self, content: &[u8], golden: &Golden) -> Result<(), DeblurError> {
            let entry = Entry::of_file("mine", 3, digest(content), 7);
            install(self.home.path(), entry, content, golden)
        }

        /// The network and its golden output, as a run gets them.
        fn resolved(&self) -> (Vec<u8>, Golden) {
            let folders = [self.home.path().to_path_buf()];
            let known = Manifest::known(&folders).expect("readable");
            let model = known.resolve("mine", &folders).expect("usable");
            (model.bytes, model.golden.expect("known"))
        }

        /// The names of the files but the overlay's.
        fn files(&self) -> Vec<String> {
            let entries = std::fs::read_dir(self.home.path()).expect("readable");
            let mut names: Vec<_> = entries
                .flatten()
                .map(|file| file.file_name().to_string_lossy().into_owned())
                .filter(|name| ![".lock", OVERLAY].contains(&name.as_str()))
                .collect();
            names.sort();
            names
        }
    }

    fn two_goldens() -> [Golden; 2] {
        [golden::view(), golden::guide()]
            .map(|image| Golden::new(image.data().to_vec()).expect("of the right size"))
    }

    #[test]
    fn a_network_that_is_replaced_stays_usable_until_the_new_one_is() {
        let (mine, [one, other]) = (Mine::new(), two_goldens());
        mine.take(b"first", &one).expect("new");
        assert_eq!(mine.files(), ["mine.golden", "mine.onnx"]);
        // A folder in the place of the new golden output, which is written after the network and
        // before the entry.
        let name = format!("mine-{}.golden", &digest(&other.to_bytes())[..8]);
        let obstacle = mine.home.path().join(name);
        std::fs::create_dir(&obstacle).expect("made");
        assert!(matches!(
            mine.take(b"second", &other),
            Err(DeblurError::ModelNotKept { .. })
        ));
        std::fs::remove_dir(&obstacle).expect("removed");
        assert_eq!(mine.resolved(), (b"first".to_vec(), one));
        assert_eq!(
            mine.files(),
            ["mine.golden", "mine.onnx"],
            "what was not finished is not left"
        );
        mine.take(b"first", &other).expect("another golden output");
        assert_eq!(mine.resolved(), (b"first".to_vec(), other));
        assert_eq!(
            mine.files().last().map(String::as_str),
            Some("mine.onnx"),
            "what is the same stays where it is"
        );
    }

    #[test]
    fn a_network_is_replaced_twice_and_when_it_is_damaged() {
        let (mine, [one, other]) = (Mine::new(), two_goldens());
        mine.take(b"first", &one).expect("new");
        mine.take(b"second", &other).expect("another network");
        mine.take(b"second", &other).expect("is there already");
        assert_eq!(mine.resolved(), (b"second".to_vec(), other));
        assert_eq!(mine.files().len(), 2);
        for name in mine.files() {
            std::fs::write(mine.home.path().join(name), "damaged").expect("written");
        }
        mine.take(b"second", &one).expect("mended");
        assert_eq!(mine.resolved(), (b"second".to_vec(), one));
        assert_eq!(mine.files().len(), 2);
    }

    #[test]
    fn a_network_that_is_replaced_once_its_entry_was_read_is_found_where_it_is_now() {
        let home = tempfile::tempdir().expect("temporary directory");
        let folders = [home.path().to_path_buf()];
        let golden = Golden::new(golden::view().data().to_vec()).expect("of the right size");
        let take = |content: &[u8]| {
            install(
                &folders[0],
                Entry::of_file("mine", 3, digest(content), 7),
                content,
                &golden,
            )
        };
        take(b"first").expect("new");
        let asked = std::cell::Cell::new(0);
        let resolve = |choice: &str| {
            asked.set(0);
            let answer = Manifest::ask(&folders, |known| {
                asked.set(asked.get() + 1);
                if asked.get() == 1 && choice == "mine" {
                    take(b"second").expect("another network");
                    assert!(matches!(
                        known.resolve(choice, &folders),
                        Err(DeblurError::ModelFileMissing { .. })
                    ));
                }
                known.resolve(choice, &folders)
            });
            (answer.expect("readable"), asked.get())
        };
        let (found, turns) = resolve("mine");
        assert_eq!(
            (found.expect("there").bytes.as_slice(), turns),
            (b"second".as_slice(), 2)
        );
        let (found, turns) = resolve("nobody's");
        assert!(
            matches!(found, Err(DeblurError::UnknownModel { .. })) && turns == 1,
            "{turns}"
        );
    }

    #[test]
    fn a_damaged_overlay_is_not_written_over() {
        let directory = tempfile::tempdir().expect("temporary directory");
        std::fs::write(directory.path().join(OVERLAY), "{").expect("write");
        let golden = Golden::new(golden::view().data().to_vec()).expect("of the right size");
        let refused = install(
            directory.path(),
            Entry::of_file("a", 3, digest(b"c"), 1),
            b"c",
            &golden,
        );
        assert!(
            matches!(refused, Err(DeblurError::ManifestUnreadable { .. })),
            "{refused:?}"
        );
        let left = std::fs::read_dir(directory.path())
            .expect("readable")
            .flatten();
        let left: Vec<_> = left
            .map(|file| file.file_name())
            .filter(|name| name != ".lock")
            .collect();
        assert_eq!(left, [OVERLAY], "nothing else is left");
    }

    #[test]
    fn neither_another_networks_file_nor_one_outside_is_written_over() {
        let home = tempfile::tempdir().expect("temporary directory");
        let directory = home.path().join("models");
        let golden = Golden::new(golden::view().data().to_vec()).expect("of the right size");
        let install = |entry: Entry| install(&directory, entry, b"content", &golden);
        // A known network's file name, under another id.
        let clash = install(Entry::of_file(
            "NAFNet-GoPro-width32",
            3,
            digest(b"content"),
            7,
        ));
        assert!(
            clash
                .expect_err("taken")
                .to_string()
                .contains("nafnet-gopro-w32")
        );
        for id in ["../outside", "/outside", "", ".hidden", "default", "a b"] {
            let refused = install(Entry::of_file(id, 3, digest(b"content"), 7));
            assert!(
                matches!(refused, Err(DeblurError::ModelNotKept { .. })),
                "{id}: {refused:?}"
            );
        }
        install(Entry::of_file("fine-1.0", 3, digest(b"content"), 7)).expect("a plain name");
        assert_eq!(std::fs::read_dir(home.path()).expect("readable").count(), 1);
    }
}
