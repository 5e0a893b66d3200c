//! Putting a network into a folder of models, so that it can be chosen by its name.

use std::path::{Path, PathBuf};

use crate::deblur::manifest::{Entry, Manifest, OVERLAY};
use crate::deblur::{DeblurError, Golden};
use crate::image::write_atomic;

/// Puts the network's file `content`, its golden output and its entry into `directory`. Each file is there whole or not at
/// all, the entry last: what is listed can be loaded.
///
/// # Errors
/// [`DeblurError::ModelNotKept`], [`DeblurError::ManifestUnreadable`] when the overlay that is there is damaged.
pub fn install(
    directory: &Path,
    mut entry: Entry,
    content: &[u8],
    golden: &Golden,
) -> Result<(), DeblurError> {
    std::fs::create_dir_all(directory).map_err(kept(directory))?;
    let file = entry.file.get_or_insert_with(|| format!("{}.onnx", entry.id)).clone();
    let expected = entry.golden.get_or_insert_with(|| format!("{}.golden", entry.id)).clone();
    let mut overlay = Manifest::overlay(directory)?;
    overlay.lay_over(entry);
    let mut text = serde_json::to_string_pretty(&overlay).expect("strings, numbers and lists");
    text.push('\n');
    write(&directory.join(file), content)?;
    write(&directory.join(expected), &golden.to_bytes())?;
    write(&directory.join(OVERLAY), text.as_bytes())
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
    use crate::deblur::manifest::{Place, digest};

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
        assert!(matches!(known.resolve("first", &folders), Err(DeblurError::ModelChecksum { .. })));
        assert!(known.resolve("second", &folders).is_ok());
    }

    #[test]
    fn a_damaged_overlay_is_not_written_over() {
        let directory = tempfile::tempdir().expect("temporary directory");
        std::fs::write(directory.path().join(OVERLAY), "{").expect("write");
        let golden = Golden::new(golden::view().data().to_vec()).expect("of the right size");
        let refused = install(directory.path(), Entry::of_file("a", 3, String::new(), 1), b"c", &golden);
        assert!(matches!(refused, Err(DeblurError::ManifestUnreadable { .. })), "{refused:?}");
        assert_eq!(std::fs::read_dir(directory.path()).expect("readable").count(), 1, "nothing else is left");
    }
}
