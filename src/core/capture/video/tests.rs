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
fn of_every_stretch_the_sharpest_frame_becomes_a_photograph() {
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
        // Older ones have the turn as metadata.
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
fn what_is_no_video_cut_short_or_a_list_of_other_files_is_refused() {
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
fn without_ffmpeg_it_says_so_and_a_cancelled_reading_ends() {
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
fn hundreds_of_frames_are_taken_and_no_more_than_there_is_room_for() {
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
fn pixels_that_are_not_square_become_square() {
    let folder = TempDir::new().expect("folder");
    let video = made(&folder, "wide.mp4", &["-vf", "scale=144:96,setsar=4/3"]);
    let taken = taken(&video, 3, folder.path()).expect("frames");
    let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
    assert_eq!((image.width(), image.height()), (192, 96));
}

/// Two parts of other sizes in one file, as no camera writes it.
#[test]
fn where_its_size_changes_the_frames_are_still_counted_once() {
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

/// A video of one grey, as HLG or PQ codes it in 10 bits.
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
fn a_larger_range_becomes_srgb_and_the_warning_says_so() {
    let folder = TempDir::new().expect("folder");
    // White of 203 nits and a dark grey of 10, as ITU-R BT.2408 and BT.2100 code them; the bend
    // above three tenths of white takes the first to 0.68 of it.
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
        let told = taken.told("it");
        assert!(told.contains(&format!("HDR ({name}) and was tone-mapped")), "{told}");
        let image = Image::<Srgb>::load(&taken.files[0]).expect("a photograph");
        for value in image.get(48, 32) {
            assert!((value - expected).abs() < 0.006, "{name} {level}: {value}");
        }
    }
    let usual = taken(&made(&folder, "usual.mp4", &[]), 3, &folder.path().join("usual"));
    assert_eq!(usual.expect("frames").hdr, None);
}

#[test]
fn what_is_not_read_is_told_by_what_it_means() {
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
