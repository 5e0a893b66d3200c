use std::process::Command;

use tempfile::TempDir;

use super::*;
use crate::image::{Image, Srgb};

/// `testsrc` moves and counts; every 10th frame, from the 5th on, is sharp and the rest blurred.
fn made(folder: &TempDir, name: &str, further: &[&str]) -> PathBuf {
    let path = folder.path().join(name);
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-f", "lavfi", "-i"])
        .arg("testsrc2=size=320x180:rate=20:duration=3")
        .args(["-vf", "boxblur=4:enable='not(eq(mod(n\\,10)\\,5))'"])
        .args(["-c:v", "libx264", "-crf", "12", "-pix_fmt", "yuv420p"])
        .args(further)
        .arg(&path)
        .status()
        .expect("ffmpeg, which `make setup` installs");
    assert!(status.success());
    path
}

fn ffmpeg() -> Vec<OsString> {
    vec!["ffmpeg".into()]
}

fn taken(video: &Path, count: usize, into: &Path) -> Result<Taken, VideoError> {
    let wanted = wanted(count, into);
    take_frames(&ffmpeg(), video, &wanted, &CancelToken::new())
}

fn wanted(count: usize, into: &Path) -> Wanted<'_> {
    Wanted { count, into, stem: "clip", room: u64::MAX }
}

fn numbers(taken: &Taken) -> Vec<usize> {
    let number = |file: &PathBuf| {
        let stem = file.file_stem().expect("a stem").to_string_lossy();
        stem.rsplit_once('-').expect("a number").1.parse().expect("digits")
    };
    taken.files.iter().map(number).collect()
}

#[test]
fn the_sharpest_frame_of_each_segment_becomes_a_photograph() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "a clip.mp4", &[]);
    let taken = taken(&video, 6, &folder.path().join("images")).expect("frames");
    assert_eq!(taken.frames, 60);
    assert_eq!(numbers(&taken), [5, 15, 25, 35, 45, 55]);
    for file in &taken.files {
        let image = Image::<Srgb>::load(file).expect("a photograph");
        assert_eq!((image.width(), image.height()), (320, 180));
    }
    let left = fs::read_dir(folder.path().join("images")).expect("read").count();
    assert_eq!(left, 6, "nothing else is left");
}

#[test]
fn a_video_held_upright_becomes_upright_photographs() {
    let folder = TempDir::new().expect("folder");
    let lying = made(&folder, "lying.mp4", &[]);
    let video = folder.path().join("upright.mov");
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-display_rotation", "90", "-i"])
        .arg(&lying)
        .args(["-c", "copy"])
        .arg(&video)
        .status();
    if !status.expect("ffmpeg").success() {
        // Older versions store the rotation as metadata.
        let status = Command::new("ffmpeg")
            .args(["-nostdin", "-loglevel", "error", "-i"])
            .arg(&lying)
            .args(["-c", "copy", "-metadata:s:v:0", "rotate=90"])
            .arg(&video)
            .status();
        assert!(status.expect("ffmpeg").success());
    }
    let taken = taken(&video, 3, folder.path()).expect("frames");
    let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
    assert_eq!((image.width(), image.height()), (180, 320));
}

#[test]
fn files_that_are_not_videos_truncated_or_playlists_are_refused() {
    let folder = TempDir::new().expect("folder");
    let whole = fs::read(made(&folder, "whole.mp4", &[])).expect("read");
    let secret = folder.path().join("secret.mp4");
    fs::write(&secret, &whole).expect("written");
    let playlist =
        format!("#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nfile:{}\n", secret.display());
    let list = format!("ffconcat version 1.0\nfile '{}'\n", secret.display());
    let cases: [(&str, Vec<u8>); 4] = [
        ("text.mp4", b"this is a text".to_vec()),
        ("cut.mp4", whole[..whole.len() / 2].to_vec()),
        ("playlist.mp4", playlist.into_bytes()),
        ("list.mp4", list.into_bytes()),
    ];
    for (name, bytes) in cases {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("written");
        let error = taken(&path, 5, &folder.path().join("out")).expect_err(name);
        assert!(matches!(error, VideoError::Unreadable { .. }), "{name}: {error}");
        let words = error.to_string();
        let folder = folder.path().display().to_string();
        assert!(!words.contains(&folder), "{name}: {words}");
    }
}

#[test]
fn a_missing_ffmpeg_is_reported_and_a_cancelled_reading_ends() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "whole.mp4", &[]);
    let cancel = CancelToken::new();
    let wanted = wanted(5, folder.path());
    let none: [&[&str]; 2] = [&["no-such-ffmpeg"], &["sh", "-c", "exec no-such-ffmpeg", "sh"]];
    for command in none {
        let command: Vec<OsString> = command.iter().map(OsString::from).collect();
        let error = take_frames(&command, &video, &wanted, &cancel);
        assert!(matches!(error, Err(VideoError::Missing { .. })), "{error:?}");
    }
    cancel.cancel();
    let error = take_frames(&ffmpeg(), &video, &wanted, &cancel);
    assert!(matches!(error, Err(VideoError::Cancelled(_))), "{error:?}");
}

#[test]
fn a_video_of_two_frames_is_too_short() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "short.mp4", &["-frames:v", "2"]);
    let error = taken(&video, 5, folder.path()).expect_err("too short");
    assert!(matches!(error, VideoError::TooShort { frames: 2 }), "{error}");
}

#[test]
fn hundreds_of_frames_are_taken_within_the_available_space() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "long.mp4", &["-t", "3", "-r", "100", "-vf", "scale=64:36"]);
    let into = folder.path().join("images");
    let taken = taken(&video, 250, &into).expect("frames");
    assert_eq!(taken.files.len(), 250);
    let mut small = wanted(250, &into);
    small.room = 250 * 64 * 36 * 3 - 1;
    let cancel = CancelToken::new();
    let error = take_frames(&ffmpeg(), &video, &small, &cancel).expect_err("no room");
    assert!(matches!(error, VideoError::NoRoom { .. }), "{error}");
}

#[test]
fn non_square_pixels_become_square() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "wide.mp4", &["-vf", "scale=144:96,setsar=4/3"]);
    let taken = taken(&video, 3, folder.path()).expect("frames");
    let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
    assert_eq!((image.width(), image.height()), (192, 96));
}

/// Two parts of different sizes in one file, as no camera writes it.
#[test]
fn frames_are_counted_once_across_a_size_change() {
    let folder = TempDir::new().expect("folder");
    let parts = [("a.mp4", "scale=320:180"), ("b.mp4", "scale=160:90")];
    for (name, size) in parts {
        made(&folder, name, &["-vf", size]);
    }
    let list = folder.path().join("list.txt");
    fs::write(&list, "file a.mp4\nfile b.mp4\n").expect("written");
    let video = folder.path().join("both.mp4");
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-f", "concat", "-i"])
        .arg(&list)
        .args(["-c", "copy"])
        .arg(&video)
        .status();
    assert!(status.expect("ffmpeg").success());
    let taken = taken(&video, 4, &folder.path().join("images")).expect("frames");
    assert_eq!(taken.files.len(), 4, "of {}", taken.frames);
}

/// A video of one grey level, coded as HLG or PQ in 10 bits.
fn grey(folder: &TempDir, name: &str, level: u32, transfer: &str) -> PathBuf {
    let path = folder.path().join(name);
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-f", "lavfi", "-i"])
        .arg("color=gray:size=96x64:rate=10:duration=0.5")
        .arg("-vf")
        .arg(format!("format=yuv420p10le,lutyuv=y={level}:u=512:v=512"))
        .args(["-c:v", "libx264", "-crf", "4", "-color_trc", transfer])
        .args(["-colorspace", "bt2020nc", "-color_primaries", "bt2020"])
        .args(["-color_range", "tv"])
        .arg(&path)
        .status();
    assert!(status.expect("ffmpeg").success());
    path
}

#[test]
fn a_larger_range_becomes_srgb_with_a_warning() {
    let folder = TempDir::new().expect("folder");
    // White of 203 nits and a dark grey of 10, coded by ITU-R BT.2408 and BT.2100; compression
    // above three tenths of white maps the first to 0.68 of it.
    let cases = [
        ("HLG", 721, "arib-std-b67", 0.843),
        ("HLG", 287, "arib-std-b67", 0.246),
        ("PQ", 573, "smpte2084", 0.843),
        ("PQ", 327, "smpte2084", 0.246),
    ];
    for (name, level, transfer, expected) in cases {
        let video = grey(&folder, &format!("{name}-{level}.mov"), level, transfer);
        let into = folder.path().join(format!("{name}-{level}"));
        let taken = taken(&video, 3, &into).expect("frames");
        let warning = taken.summary("it");
        assert!(warning.contains(&format!("HDR ({name}) and was tone-mapped")), "{warning}");
        let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
        for value in image.get(48, 32) {
            assert!((value - expected).abs() < 0.006, "{name} {level}: {value}");
        }
    }
    let usual = taken(&made(&folder, "usual.mp4", &[]), 3, &folder.path().join("usual"));
    assert_eq!(usual.expect("frames").hdr, None);
}

#[test]
fn unsupported_videos_are_reported_with_the_cause() {
    let folder = TempDir::new().expect("folder");
    let make = |name: &str, input: &str, further: &[&str]| {
        let path = folder.path().join(name);
        let status = Command::new("ffmpeg")
            .args(["-nostdin", "-loglevel", "error", "-f", "lavfi", "-i", input])
            .args(further)
            .arg(&path)
            .status();
        assert!(status.expect("ffmpeg").success());
        path
    };
    let sound = make("sound.mov", "sine=duration=1", &[]);
    let other = make("other.mov", "testsrc2=duration=1", &["-c:v", "qtrle"]);
    let matroska = make("walk.mkv", "testsrc2=duration=1", &["-c:v", "libx264"]);
    let renamed = folder.path().join("renamed.mov");
    fs::copy(&matroska, &renamed).expect("copied");
    let cases = [
        (sound, "there is no picture in the file, only sound"),
        (other, "coded in a way that is not read"),
        (matroska, "Matroska or WebM videos are not read"),
        (renamed, "Matroska or WebM videos are not read"),
    ];
    for (path, words) in cases {
        let error = taken(&path, 3, &folder.path().join("out")).expect_err(words);
        assert!(error.to_string().contains(words), "{error}");
        assert!(!error.to_string().contains("trailing"), "{error}");
    }
}

/// A video drawn by an ffmpeg filter.
fn drawn(folder: &TempDir, name: &str, source: &str, further: &[&str]) -> PathBuf {
    let path = folder.path().join(name);
    let status = Command::new("ffmpeg")
        .args(["-nostdin", "-loglevel", "error", "-f", "lavfi", "-i", source])
        .args(["-c:v", "libx264", "-crf", "4", "-pix_fmt", "yuv420p"])
        .args(further)
        .arg(&path)
        .status();
    assert!(status.expect("ffmpeg").success());
    path
}

#[test]
fn undeclared_colours_are_hd_colours_from_720_lines() {
    let folder = TempDir::new().expect("folder");
    let colour = "color=0x1A991A:rate=10:duration=0.5:size=";
    let cases = [
        // Size, the matrix it is coded with, the tags.
        ("1280x720", "bt709", "unknown"),
        ("1280x534", "bt709", "unknown"),
        ("720x1280", "bt709", "unknown"),
        ("720x576", "bt601", "unknown"),
        ("1280x720", "bt601", "smpte170m"),
        ("640x360", "bt709", "bt709"),
    ];
    for (at, (size, matrix, tag)) in cases.into_iter().enumerate() {
        let coded = format!("format=gbrp,scale=out_color_matrix={matrix},format=yuv420p");
        // x264 writes no tag for `unknown`.
        let tags = format!("setparams=colorspace={tag}");
        let filters = ["-vf", &format!("{coded},{tags}")];
        let video = drawn(&folder, &format!("{at}.mp4"), &format!("{colour}{size}"), &filters);
        let taken = taken(&video, 3, &folder.path().join(at.to_string())).expect("frames");
        let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
        let found = image.get(100, 100).map(|v| (v * 255.0).round());
        for (found, wanted) in found.into_iter().zip([26.0, 153.0, 26.0]) {
            assert!((found - wanted).abs() < 4.0, "{size} {matrix} {tag}: {found} for {wanted}");
        }
    }
}

/// Vertical stripes that move by 6 px from field to field.
const STRIPES: &str = "nullsrc=size=160x128:rate=50:duration=1.2,\
    geq=lum='128+100*sin((X+6*N)/5)':cb=128:cr=128";

/// How much more rows differ from their neighbours than from the rows beyond, levels.
fn comb(image: &Image<Srgb>) -> f32 {
    let (width, height) = (image.width(), image.height());
    let row = |y: usize| &image.plane(1)[y * width..(y + 1) * width];
    let apart = |rows: usize| {
        let pairs = (0..height - 2).flat_map(|y| row(y).iter().zip(row(y + rows)));
        pairs.map(|(a, b)| (a - b).abs()).sum::<f32>()
    };
    255.0 * (apart(1) - apart(2)) / ((height - 2) * width) as f32
}

/// The most combed photograph, and the warning about the video.
fn combed(command: &[OsString], video: &Path) -> Result<(f32, String), VideoError> {
    let into = video.with_extension("frames");
    let taken = take_frames(command, video, &wanted(4, &into), &CancelToken::new())?;
    let images = taken.files.iter().map(|file| Image::<Srgb>::load(file).expect("a photograph"));
    let worst = images.map(|image| comb(&image).max(comb(&transposed(&image)))).fold(0.0, f32::max);
    Ok((worst, taken.summary("it")))
}

fn transposed(image: &Image<Srgb>) -> Image<Srgb> {
    let mut turned = Image::new(image.height(), image.width());
    for y in 0..image.height() {
        for x in 0..image.width() {
            turned.set(y, x, image.get(x, y));
        }
    }
    turned
}

#[test]
fn interlaced_video_is_deinterlaced_even_if_undeclared() {
    let folder = TempDir::new().expect("folder");
    let fields = ["-flags", "+ilme+ildct"];
    let cases: [(&str, &str, &[&str], bool); 5] = [
        ("top.mp4", "interlace=scan=tff:lowpass=0", &fields, true),
        ("bottom.mp4", "interlace=scan=bff:lowpass=0", &fields, true),
        ("silent-top.mp4", "interlace=scan=tff:lowpass=0,setfield=prog", &[], true),
        ("silent-bottom.mov", "interlace=scan=bff:lowpass=0,setfield=prog", &[], true),
        ("whole.mp4", "fps=25", &[], false),
    ];
    for (name, filter, flags, is_interlaced) in cases {
        let further: Vec<&str> = ["-vf", filter].iter().chain(flags).copied().collect();
        let video = drawn(&folder, name, STRIPES, &further);
        let (worst, warning) = combed(&ffmpeg(), &video).expect("frames");
        assert!(worst < 1.0, "{name}: {worst}");
        assert_eq!(warning.contains("interlaced and was deinterlaced"), is_interlaced, "{warning}");
    }
}

#[test]
fn interlaced_video_held_upright_is_deinterlaced_by_its_stored_rows() {
    let folder = TempDir::new().expect("folder");
    let further = ["-vf", "interlace=scan=tff:lowpass=0", "-flags", "+ilme+ildct"];
    let mut bytes = fs::read(drawn(&folder, "lying.mp4", STRIPES, &further)).expect("read");
    // The track's matrix: a quarter turn. It follows 40 bytes after the version of tkhd.
    let at = bytes.windows(4).position(|window| window == b"tkhd").expect("a track") + 4 + 40;
    let matrix: [i32; 9] = [0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30];
    for (number, value) in matrix.into_iter().enumerate() {
        bytes[at + 4 * number..][..4].copy_from_slice(&value.to_be_bytes());
    }
    let video = folder.path().join("upright.mp4");
    fs::write(&video, bytes).expect("written");
    let (worst, warning) = combed(&ffmpeg(), &video).expect("frames");
    assert!(worst < 1.0, "{worst}");
    assert!(warning.contains("deinterlaced"), "{warning}");
    let file = fs::read_dir(video.with_extension("frames")).expect("read").next();
    let image = Image::<Srgb>::load(&file.expect("one").expect("read").path()).expect("read");
    assert_eq!((image.width(), image.height()), (128, 160));
}

#[test]
fn an_ffmpeg_without_deinterlacing_filters_is_reported() {
    let folder = TempDir::new().expect("folder");
    let further = ["-vf", "interlace=scan=tff:lowpass=0", "-flags", "+ilme+ildct"];
    let video = drawn(&folder, "fields.mp4", STRIPES, &further);
    let without = |filters: &str| {
        let script = format!(
            "case \"$*\" in {filters}) echo \"No such filter\" >&2; exit 1;; esac; exec ffmpeg \"$@\""
        );
        ["sh", "-c", &script, "sh"].map(OsString::from)
    };
    let (worst, warning) = combed(&without("*bwdif*"), &video).expect("yadif is there");
    assert!(worst < 1.0 && warning.contains("deinterlaced"), "{worst}: {warning}");
    let error = combed(&without("*bwdif*|*yadif*"), &video).expect_err("neither");
    assert!(matches!(error, VideoError::Interlaced), "{error}");
    assert!(error.hint().contains("deinterlace"), "{}", error.hint());
}

/// An MP4 box.
fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let length = (content.len() + 8) as u32;
    [&length.to_be_bytes(), kind.as_slice(), content].concat()
}

/// Appends a box to the last of nested boxes.
fn appended(mut bytes: Vec<u8>, path: &[&[u8; 4]], addition: &[u8]) -> Vec<u8> {
    let (mut from, mut end) = (0, bytes.len());
    for kind in path {
        let found = bytes[from..end].windows(4).position(|window| window == kind.as_slice());
        let at = from + found.expect("the box") - 4;
        let length = u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four"));
        let longer = length + addition.len() as u32;
        bytes[at..at + 4].copy_from_slice(&longer.to_be_bytes());
        (from, end) = (at + 8, at + length as usize);
    }
    bytes.splice(end..end, addition.iter().copied());
    bytes
}

#[test]
fn a_panoramic_video_is_refused_by_name() {
    let folder = TempDir::new().expect("folder");
    let flat = fs::read(drawn(&folder, "flat.mp4", "testsrc2=size=128x64:duration=1", &[]));
    let flat = flat.expect("read");
    // As YouTube describes them: Spherical Video, versions 2 and 1.
    let head = boxed(b"svhd", b"\0\0\0\0camera\0");
    let projection = [boxed(b"prhd", &[0; 16]), boxed(b"equi", &[0; 20])].concat();
    let second = boxed(b"sv3d", &[head, boxed(b"proj", &projection)].concat());
    let entry: [&[u8; 4]; 7] = [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1"];
    let uuid = b"\xff\xcc\x82\x63\xf8\x55\x4a\x93\x88\x14\x58\x7a\x02\x52\x1f\xdd";
    let xml = "<rdf:SphericalVideo><GSpherical:Spherical>true</GSpherical:Spherical>\
        <GSpherical:Stitched>true</GSpherical:Stitched><GSpherical:ProjectionType>equirectangular\
        </GSpherical:ProjectionType>";
    let software = "<GSpherical:StitchingSoftware>a tool</GSpherical:StitchingSoftware>";
    let first = |xml: &str| boxed(b"uuid", &[uuid.as_slice(), xml.as_bytes()].concat());
    let whole = first(&format!("{xml}{software}</rdf:SphericalVideo>"));
    let short = first(&format!("{xml}</rdf:SphericalVideo>"));
    let cases = [
        ("second.mp4", appended(flat.clone(), &entry, &second), "(equirectangular)"),
        ("first.mov", appended(flat.clone(), &entry[..2], &whole), "(equirectangular)"),
        ("short.mov", appended(flat.clone(), &entry[..2], &short), "(of some projection)"),
    ];
    for (name, bytes, projection) in cases {
        let path = folder.path().join(name);
        fs::write(&path, bytes).expect("written");
        let error = taken(&path, 3, &folder.path().join("out")).expect_err(name);
        assert!(
            error.to_string().contains(&format!("360 degrees {projection}")),
            "{name}: {error}"
        );
        assert!(error.hint().contains("flat (reframed) views"), "{}", error.hint());
    }
    // Being twice as wide as high is not evidence on its own.
    let path = folder.path().join("flat.mp4");
    taken(&path, 3, &folder.path().join("out")).expect("frames");
}
