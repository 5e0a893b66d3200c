//! Unpacks a zip that may be hostile.
//!
//! Everything is checked in the central directory before a byte is written. Then only files with a
//! role are unpacked, photographs under our own names, so no name in the archive ever becomes a
//! path.

use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use zip::CompressionMethod;
use zip::read::{ZipArchive, ZipFile};
use zip::result::ZipError;

use crate::image::{MAX_FILE_BYTES, Unread, named_like_a_photograph};
use crate::photo_path::PhotoPath;
use crate::plain::is_plain;

use super::entries::{Entry, is_hidden};
use super::error::{ArchiveFault, CaptureError, MAX_FILES};
use super::heads;
use super::layout::hold;
use super::pose_files::POSE_FILES;
use super::video::is_video;

/// Largest total unpacked size of an archive, bytes.
pub const MAX_ARCHIVE_BYTES: u64 = 8 << 30;

/// Largest compression ratio of a large file: photographs hardly compress, and even an uncompressed
/// dark TIFF stays under 20; a bomb compresses 1000 times.
const MAX_RATIO: u64 = 100;

/// Files up to this size may have any ratio: 1 MiB of zeros is harmless.
const RATIO_FREE_BYTES: u64 = 1 << 20;

/// Largest compression ratio of all files together: many small ones are a bomb, too. Above that of
/// the darkest uncompressed TIFFs.
const MAX_TOTAL_RATIO: u64 = 25;

/// Archives up to this unpacked size may have any ratio.
const TOTAL_RATIO_FREE_BYTES: u64 = 64 << 20;

/// Largest file that is unpacked only to identify it; pose lists are smaller.
const MAX_METADATA_BYTES: u64 = 64 << 20;

/// Largest total size of such files, bytes.
const MAX_METADATA_TOTAL: u64 = 256 << 20;

/// Compression methods that are read. Windows uses Deflate64 for files over 2 GB.
const READ_METHODS: [CompressionMethod; 3] =
    [CompressionMethod::Stored, CompressionMethod::Deflated, CompressionMethod::Deflate64];

/// Other methods in use.
const UNREAD_METHODS: [(CompressionMethod, &str); 6] = [
    (CompressionMethod::BZIP2, "bzip2"),
    (CompressionMethod::LZMA, "LZMA"),
    (CompressionMethod::ZSTD, "Zstandard"),
    (CompressionMethod::XZ, "XZ"),
    (CompressionMethod::PPMD, "PPMd"),
    (CompressionMethod::IMPLODE, "Implode"),
];

/// Whether a file has the signature of a zip.
pub(super) fn is_zip(path: &Path) -> io::Result<bool> {
    let mut head = Vec::new();
    File::open(path)?.take(4).read_to_end(&mut head)?;
    Ok(head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06"))
}

/// Unpacks the files with a role into `target`, which is recreated, and returns them with their
/// names in the archive. On failure `target` is removed.
pub(super) fn unpack(path: &Path, target: &Path) -> Result<Vec<Entry>, CaptureError> {
    let (mut archive, wanted) = open(path)?;
    match fs::remove_dir_all(target) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(CaptureError::io(target)(error));
        }
        _ => (),
    }
    let outcome = unpack_all(&mut archive, wanted, target);
    if outcome.is_err() {
        // Report the first error, not this one.
        let _ = fs::remove_dir_all(target);
    }
    outcome
}

/// Unpacked size of the files of a zip, bytes; 0 if `path` is not a zip.
///
/// # Errors
/// [`CaptureError::Archive`] for a zip that cannot be unpacked, and file system errors.
pub fn unpacked_bytes(path: &Path) -> Result<u64, CaptureError> {
    if !is_zip(path).map_err(CaptureError::io(path))? {
        return Ok(0);
    }
    let (_, wanted) = open(path)?;
    Ok(wanted.iter().filter(|item| item.is_unpacked).map(|item| item.size).sum())
}

/// Writes one file of a zip: the one unpacked as `file`, wherever that was.
///
/// # Errors
/// [`CaptureError::Archive`] for a zip that cannot be unpacked or has no such file, and file system
/// errors, including those of `out`.
pub fn write_unpacked(path: &Path, file: &Path, out: &mut impl Write) -> Result<(), CaptureError> {
    let (mut archive, wanted) = open(path)?;
    let number = file.file_stem().and_then(|stem| stem.to_str()?.parse::<usize>().ok());
    let item = number.and_then(|number| wanted.get(number)).filter(|item| item.is_unpacked);
    let item = item.ok_or_else(|| ArchiveFault::whole("has no such file"))?;
    let mut source = archive
        .by_index(item.index)
        .map_err(|error| ArchiveFault::of(&item.name, in_words(&error)))?;
    copy_one(&mut source, item, out, path)
}

/// Opens a zip and checks its directory against the rules.
fn open(path: &Path) -> Result<(ZipArchive<File>, Vec<Selected>), CaptureError> {
    let mut file = File::open(path).map_err(CaptureError::io(path))?;
    let length = file.metadata().map_err(CaptureError::io(path))?.len();
    refuse_absurd_counts(&mut file)?;
    let mut archive =
        ZipArchive::new(file).map_err(|error| ArchiveFault::whole(in_words(&error)))?;
    let wanted = check(&mut archive, length)?;
    Ok((archive, wanted))
}

/// Reads the number of entries from the archive's end before the directory is read into memory.
fn refuse_absurd_counts(file: &mut File) -> Result<(), ArchiveFault> {
    const RECORD: usize = 22;
    let broken = |_| ArchiveFault::whole("cannot be read");
    let length = file.seek(SeekFrom::End(0)).map_err(broken)?;
    let tail = length.min((RECORD + usize::from(u16::MAX)) as u64);
    file.seek(SeekFrom::Start(length - tail)).map_err(broken)?;
    let mut bytes = Vec::with_capacity(tail as usize);
    file.take(tail).read_to_end(&mut bytes).map_err(broken)?;
    file.rewind().map_err(broken)?;
    let at = bytes.windows(4).rposition(|window| window == b"PK\x05\x06");
    let record = at.and_then(|at| bytes.get(at..at + RECORD));
    let record =
        record.ok_or_else(|| ArchiveFault::whole("cut short: its directory is missing"))?;
    // 65,535 means "see the zip64 record": more than the limit in any case.
    let count = usize::from(u16::from_le_bytes([record[10], record[11]]));
    if count > MAX_FILES {
        return Err(ArchiveFault::whole(format!("more than {MAX_FILES} entries")));
    }
    Ok(())
}

/// An entry that is unpacked or only listed.
struct Selected {
    index: usize,
    name: String,
    size: u64,
    is_unpacked: bool,
    role: Role,
}

/// The reason for unpacking an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    /// A photograph.
    Photograph,
    /// Poses, or the list of held-out photographs.
    Known,
    /// Identifies whether the format is unsupported, as its name suggests.
    Unread,
    /// The content decides whether it is used.
    Metadata,
    /// Not unpacked: a video or an archive.
    Listed,
}

/// Bytes of the entries that are unpacked.
#[derive(Default)]
struct Totals {
    unpacked: u64,
    packed: u64,
    metadata: u64,
}

impl Totals {
    /// Whether an entry is unpacked. The limits apply only to entries that are unpacked: an unused
    /// or disallowed entry is never touched, whatever its size.
    fn admits<R: Read>(
        &mut self,
        name: &str,
        entry: &ZipFile<'_, R>,
        role: Role,
    ) -> Result<bool, ArchiveFault> {
        let size = entry.size();
        match role {
            Role::Listed => return Ok(false),
            Role::Metadata | Role::Unread => {
                let is_fit =
                    size <= MAX_METADATA_BYTES && self.metadata + size <= MAX_METADATA_TOTAL;
                if !is_fit || check_entry(name, entry).is_err() {
                    return Ok(false);
                }
                self.metadata += size;
            }
            Role::Photograph | Role::Known => check_entry(name, entry)?,
        }
        if role == Role::Photograph && size > MAX_FILE_BYTES {
            return Ok(false);
        }
        self.unpacked = self.unpacked.saturating_add(size);
        self.packed = self.packed.saturating_add(entry.compressed_size());
        if self.unpacked > MAX_ARCHIVE_BYTES {
            return Err(ArchiveFault::of(name, "unpacked, the archive is larger than 8 GiB"));
        }
        Ok(true)
    }

    fn check(&self, length: u64) -> Result<(), ArchiveFault> {
        let packed = self.packed.min(length);
        if self.unpacked > TOTAL_RATIO_FREE_BYTES && self.unpacked / MAX_TOTAL_RATIO > packed {
            return Err(ArchiveFault::whole("all files together shrunk more than photographs can"));
        }
        Ok(())
    }
}

/// Checks every entry against the rules and returns those with a role.
fn check(archive: &mut ZipArchive<File>, length: u64) -> Result<Vec<Selected>, ArchiveFault> {
    let whole = |error: ZipError| ArchiveFault::whole(in_words(&error));
    if archive.len() > MAX_FILES {
        return Err(ArchiveFault::whole(format!("more than {MAX_FILES} entries")));
    }
    if archive.has_duplicate_names() {
        return Err(ArchiveFault::whole("two entries have the same name"));
    }
    if archive.has_overlapping_entries().map_err(whole)? {
        return Err(ArchiveFault::whole("entries overlap"));
    }
    let (mut wanted, mut totals) = (Vec::new(), Totals::default());
    for index in 0..archive.len() {
        let entry = archive.by_index_raw(index).map_err(whole)?;
        let name = name_of(&entry).map_err(whole)?;
        check_name(&name)?;
        check_kind(&name, &entry)?;
        let Some(role) = role(&name).filter(|_| entry.is_file()) else {
            continue;
        };
        let size = entry.size();
        let is_unpacked = totals.admits(&name, &entry, role)?;
        if !is_unpacked && role == Role::Metadata {
            continue;
        }
        // Only these names are shown and stored, unlike macOS's `Icon\r`.
        if !is_plain(&name) {
            let shown = name.escape_debug().to_string();
            return Err(ArchiveFault::of(&shown, "a name with control characters"));
        }
        wanted.push(Selected { index, name, size, is_unpacked, role });
    }
    totals.check(length)?;
    // Photographs are requested by number; files unpacked for inspection must not change it.
    wanted.sort_by_key(|item| item.role == Role::Metadata);
    Ok(wanted)
}

/// The name of an entry, with `/` for the backslashes of old Windows packers. In an East Asian code
/// page a backslash may be the second byte of a character.
fn name_of<R: Read>(entry: &ZipFile<'_, R>) -> Result<String, ZipError> {
    if let Ok(name) = str::from_utf8(entry.name_raw()) {
        return Ok(name.replace('\\', "/"));
    }
    let mut last = ' ';
    let name = entry.name()?;
    let separated = name.chars().map(|character| {
        let is_second_byte = !last.is_ascii();
        last = character;
        match character {
            '\\' if is_second_byte => '\u{a5}',
            '\\' => '/',
            character => character,
        }
    });
    Ok(separated.collect())
}

fn check_name(name: &str) -> Result<(), ArchiveFault> {
    let refuse = |reason| Err(ArchiveFault::of(name, reason));
    let bytes = name.as_bytes();
    if name.is_empty() || name.contains('\0') {
        return refuse("an empty name or one with a zero byte");
    }
    if name.starts_with('/')
        || (bytes.len() > 1 && bytes[1] == b':' && bytes[0].is_ascii_alphabetic())
    {
        return refuse("an absolute path");
    }
    if name.split('/').any(|part| part == "..") {
        return refuse("a path that leads out of the archive");
    }
    Ok(())
}

/// Whether an entry is a file or a folder and not an archive, used or not.
fn check_kind<R: Read>(name: &str, entry: &ZipFile<'_, R>) -> Result<(), ArchiveFault> {
    // The upper bits of a Unix mode are the file type: 0 where the packer did not set it.
    let kind = entry.unix_mode().unwrap_or(0) & 0o170_000;
    if entry.is_symlink() || !matches!(kind, 0 | 0o100_000 | 0o040_000) {
        return Err(ArchiveFault::of(name, "a link or special file"));
    }
    if Path::new(name).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("zip")) {
        return Err(ArchiveFault::of(name, "an archive inside the archive"));
    }
    Ok(())
}

/// Whether an entry can be unpacked.
fn check_entry<R: Read>(name: &str, entry: &ZipFile<'_, R>) -> Result<(), ArchiveFault> {
    let refuse = |reason: &str| Err(ArchiveFault::of(name, reason));
    if entry.encrypted() {
        return refuse("encrypted");
    }
    if !READ_METHODS.contains(&entry.compression()) {
        let known = |method: &&(CompressionMethod, &str)| method.0 == entry.compression();
        let name = UNREAD_METHODS.iter().find(known);
        let name = name.map_or("an unknown method", |method| method.1);
        return refuse(&format!(
            "packed by {name}, which is not read; pack it with Deflate, as programs do where \
             nothing else is chosen"
        ));
    }
    if entry.size() > RATIO_FREE_BYTES && entry.size() / MAX_RATIO > entry.compressed_size() {
        return refuse("shrunk more than a photograph can be");
    }
    Ok(())
}

/// The role of an entry of this name; `None` if it is not used.
fn role(name: &str) -> Option<Role> {
    if name.split('/').any(is_hidden) {
        return None;
    }
    let path = Path::new(name);
    let last = name.rsplit('/').next().unwrap_or(name);
    Some(match () {
        () if named_like_a_photograph(path) && Unread::named(path).is_some() => Role::Unread,
        () if named_like_a_photograph(path) => Role::Photograph,
        () if POSE_FILES.contains(&&*last.to_ascii_lowercase()) || hold(last).is_some() => {
            Role::Known
        }
        // The user may take it for a photograph.
        () if is_video(path) || Unread::named(path).is_some() => Role::Listed,
        () if heads::is_recognisable(name) => Role::Metadata,
        () => return None,
    })
}

fn unpack_all(
    archive: &mut ZipArchive<File>,
    wanted: Vec<Selected>,
    target: &Path,
) -> Result<Vec<Entry>, CaptureError> {
    fs::create_dir_all(target).map_err(CaptureError::io(target))?;
    let mut folders: Vec<String> = Vec::new();
    let mut entries = Vec::with_capacity(wanted.len());
    for (number, item) in wanted.into_iter().enumerate() {
        let file = own_file(target, &item.name, number, &mut folders)?;
        let entry = Entry::new(PhotoPath::new(&item.name), file.clone());
        if !item.is_unpacked {
            let too_large = (item.role != Role::Listed).then_some(item.size);
            entries.push(Entry { too_large, ..entry });
            continue;
        }
        let mut source = archive
            .by_index(item.index)
            .map_err(|error| ArchiveFault::of(&item.name, in_words(&error)))?;
        unpack_one(&mut source, &item, &file)?;
        entries.push(entry);
    }
    Ok(entries)
}

/// The destination of an entry: a number and its known extension, or a pose file's known name in a
/// folder numbered after the entry's folder.
fn own_file(
    target: &Path,
    name: &str,
    number: usize,
    folders: &mut Vec<String>,
) -> Result<PathBuf, CaptureError> {
    let (folder, last) = name.rsplit_once('/').unwrap_or(("", name));
    let last = last.to_ascii_lowercase();
    if !POSE_FILES.contains(&last.as_str()) {
        // From a list of extensions: short, letters and digits only.
        let extension = last.rsplit_once('.').map_or("", |(_, extension)| extension);
        return Ok(target.join(format!("{number:05}.{extension}")));
    }
    let position = folders.iter().position(|known| known == folder).unwrap_or_else(|| {
        folders.push(folder.to_owned());
        folders.len() - 1
    });
    let own_folder = target.join(format!("poses{position}"));
    fs::create_dir_all(&own_folder).map_err(CaptureError::io(&own_folder))?;
    // COLMAP requires exactly this name for its points.
    Ok(own_folder.join(last.replace("points3d", "points3D")))
}

/// Unpacks one entry into a new file.
fn unpack_one(source: &mut impl Read, item: &Selected, file: &Path) -> Result<(), CaptureError> {
    let mut out = File::create_new(file).map_err(CaptureError::io(file))?;
    copy_one(source, item, &mut out, file)
}

/// Copies one entry to `out`, at most as many bytes as its directory declares; `place` appears in
/// errors.
fn copy_one(
    source: &mut impl Read,
    item: &Selected,
    out: &mut impl Write,
    place: &Path,
) -> Result<(), CaptureError> {
    let mut buffer = vec![0; 64 << 10];
    let mut written = 0;
    loop {
        let read = source
            .read(&mut buffer)
            .map_err(|error| ArchiveFault::of(&item.name, damaged(&error)))?;
        if read == 0 {
            break;
        }
        written += read as u64;
        if written > item.size {
            return Err(
                ArchiveFault::of(&item.name, "longer than the archive's directory says").into()
            );
        }
        out.write_all(&buffer[..read]).map_err(CaptureError::io(place))?;
    }
    if written != item.size {
        return Err(
            ArchiveFault::of(&item.name, "shorter than the archive's directory says").into()
        );
    }
    Ok(())
}

fn damaged(error: &io::Error) -> String {
    format!("damaged or cut short; its reader says: {error}")
}

fn in_words(error: &ZipError) -> String {
    match error {
        ZipError::Io(error) => damaged(error),
        ZipError::UnsupportedArchive(what) => format!("a kind of zip that is not read: {what}"),
        error => format!("damaged, or no zip; its reader says: {error}"),
    }
}
