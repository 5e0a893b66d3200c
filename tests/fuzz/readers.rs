//! Readers of untrusted input, given bytes as a fuzzer makes them: none may panic, overflow, or
//! take memory out of proportion to the bytes. Their results are tested elsewhere.

use std::fs;
use std::path::{Path, PathBuf};

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use fled_core::capture;
use fled_core::dataset::GivenPoses;
use fled_core::gaussians::ply;
use fled_core::image::read_header;
use fled_core::photo_path::PhotoPath;
use fled_core::poses::bounds::read_poses_bounds;
use fled_core::poses::model::SparseModel;

/// The folder of the readers' input files: in memory, one per process.
fn folder() -> PathBuf {
    let memory = Path::new("/dev/shm");
    let root = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let folder = root.join(format!("fled-fuzz-{}", std::process::id()));
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn written(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    fs::write(&path, bytes).expect("written");
    path
}

/// A zip's directory, checked against the rules before anything is unpacked.
pub fn zip(bytes: &[u8]) {
    let _ = capture::unpacked_bytes(&written("upload.zip", bytes));
}

/// The EXIF block of an otherwise valid JPEG.
pub fn exif(bytes: &[u8]) {
    /// Gray, 8 x 8 px.
    const REST: &[u8] = include_bytes!("gray.jpg");
    let block = &bytes[..bytes.len().min(60_000)];
    let mut jpeg = vec![0xff, 0xd8, 0xff, 0xe1];
    jpeg.extend(((block.len() + 8) as u16).to_be_bytes());
    jpeg.extend(b"Exif\0\0");
    jpeg.extend(block);
    jpeg.extend(&REST[2..]);
    let header = read_header(&written("photograph.jpg", &jpeg));
    let header = header.expect("the picture is whole whatever its EXIF says");
    assert!(header.focal_px.is_none_or(|focal| focal.is_finite() && focal > 0.0));
}

/// A scene.
pub fn ply(bytes: &[u8]) {
    let path = written("scene.ply", bytes);
    let extent = ply::read_extent(&path);
    if let Ok(scene) = ply::read(&path) {
        assert_eq!(extent.ok().map(|extent| extent.gaussians), Some(scene.gaussians.len()));
    }
}

/// LLFF's poses.
pub fn npy(bytes: &[u8]) {
    let _ = read_poses_bounds(&written("poses_bounds.npy", bytes));
}

/// The cameras of instant-ngp and its relatives.
pub fn transforms(bytes: &[u8]) {
    let photographs = ["0.jpg", "1.jpg", "images/2.png"].map(PhotoPath::new);
    let given = GivenPoses::open(&written("transforms.json", bytes), &photographs);
    if let Ok(given) = given {
        let _ = given.count();
        let _ = given.names();
    }
}

/// A COLMAP model: the first byte says whether its files are binary, and the two numbers after it
/// split the rest into three.
pub fn colmap(bytes: &[u8]) {
    let [kind, a, b, c, d, rest @ ..] = bytes else {
        return;
    };
    let end = |high: &u8, low: &u8| usize::from(u16::from_be_bytes([*high, *low])).min(rest.len());
    let (first, second) = (end(a, b), end(c, d));
    let second = second.max(first);
    let extension = if kind % 2 == 0 { "bin" } else { "txt" };
    let folder = folder().join(extension);
    fs::create_dir_all(&folder).expect("a folder");
    for (name, part) in [
        ("cameras", &rest[..first]),
        ("images", &rest[first..second]),
        ("points3D", &rest[second..]),
    ] {
        fs::write(folder.join(format!("{name}.{extension}")), part).expect("written");
    }
    let _ = SparseModel::read(&folder);
}

/// The headers of an upload in pieces, one per line.
pub fn tus(bytes: &[u8]) {
    let mut headers = HeaderMap::new();
    for line in bytes.split(|byte| *byte == b'\n') {
        let mut parts = line.splitn(2, |byte| *byte == b':');
        let name = HeaderName::from_bytes(parts.next().unwrap_or_default());
        let value = HeaderValue::from_bytes(parts.next().unwrap_or_default());
        if let (Ok(name), Ok(value)) = (name, value) {
            headers.append(name, value);
        }
    }
    let _ = fled_server::read_tus_headers(&headers);
}
