//! Uploads through a real server process: what is accepted, refused, and stored where.

use std::thread::sleep;
use std::time::{Duration, Instant};

use fled_core::image::Image;

use crate::support::{Server, file, photograph, photographs, text, zip};

#[test]
fn bad_files_are_listed_until_too_few_good_ones_remain() {
    let server = Server::start();
    let mut parts = photographs(3);
    parts.push(file("broken.jpg", b"this is text"));
    let reply = server.upload("/v1/captures", &parts, &[]).expect(201).json();
    assert_eq!(reply["accepted"], 3);
    let images = reply["images"].as_array().expect("assessments");
    let broken = images.iter().find(|image| image["name"] == "broken.jpg").expect("listed");
    assert!(broken["accepted"] == false && broken["reason"].is_string(), "{broken}");
    let reply = server.upload("/v1/captures", &parts[2..], &[]).expect(422);
    assert_eq!(reply.header("content-type"), "application/problem+json");
    let problem = reply.json();
    assert_eq!(problem["code"], "bad_input");
    assert!(
        problem["hint"].is_string()
            && problem["capture"]["images"].as_array().is_some_and(|v| v.len() == 2)
    );
    server.upload("/v1/captures", &[text("name", "nothing")], &[]).expect(422);
    let dry = server.upload("/v1/captures?dry_run", &photographs(3), &[]).expect(200).json();
    assert!(dry["id"].is_null() && dry["accepted"] == 3);
    let list = server.get("/v1/captures", &[]).expect(200).json();
    assert_eq!(
        list["captures"].as_array().map(Vec::len),
        Some(1),
        "only what was accepted is kept"
    );
    // Their folders are removed with the validation process, which ends shortly after the answer.
    let begun = Instant::now();
    let incoming = server.data.path().join("data/incoming");
    while std::fs::read_dir(&incoming).expect("folder").count() > 0 {
        let patience = Duration::from_secs(5);
        assert!(begun.elapsed() < patience, "refused uploads leave files");
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_zip_is_validated_by_its_own_names_and_stored_unchanged() {
    let server = Server::start();
    let names = ["walk/images/a.png", "walk/images/b.png", "walk/images/c.png", "walk/gt/a.png"];
    let content: Vec<(&str, Vec<u8>)> =
        (0..).zip(names).map(|(i, name)| (name, photograph(i))).collect();
    let reply =
        server.upload("/v1/captures", &[file("walk.zip", &zip(&content))], &[]).expect(201).json();
    assert_eq!(reply["accepted"], 3, "ground truth is no photograph: {reply:#}");
    assert_eq!(reply["images"][0]["name"], "a.png");
    let capture = server.data.path().join("data/captures").join(reply["id"].as_str().expect("id"));
    let mut kept: Vec<_> =
        std::fs::read_dir(capture).expect("folder").flatten().map(|e| e.file_name()).collect();
    kept.sort();
    assert_eq!(kept, [".thumbnails", "upload.zip"]);
    let bad =
        server.upload("/v1/captures", &[file("a.zip", b"no zip at all")], &[]).expect(422).json();
    assert!(
        !bad["detail"].as_str().expect("detail").contains("incoming"),
        "a path of the server is shown: {bad}"
    );
    let parts = [file("walk.zip", &zip(&content)), file("a.png", &photograph(1))];
    server.upload("/v1/captures", &parts, &[]).expect(422);
}

#[test]
fn names_cannot_escape_the_capture() {
    let server = Server::start();
    let names =
        ["../../../evil.png", "/etc/evil.png", "a\\..\\..\\evil.png", "-rf.png", "日本.png"];
    let parts: Vec<_> =
        names.iter().enumerate().map(|(i, name)| file(name, &photograph(i))).collect();
    let reply = server.upload("/v1/captures", &parts, &[]).expect(201).json();
    assert_eq!(reply["accepted"], 5, "{reply:#}");
    let capture = server.data.path().join("data/captures").join(reply["id"].as_str().expect("id"));
    assert_eq!(std::fs::read_dir(capture.join("images")).expect("images").count(), 5);
    assert!(
        !server.data.path().join("evil.png").exists()
            && !server.data.path().join("data/evil.png").exists()
    );
}

#[test]
fn a_photograph_is_named_by_the_path_it_was_sent_with() {
    let server = Server::start();
    let names = ["cam0/0.png", "cam0/1.png", "cam1\\0.png", "cam1/a%22b.png"];
    let parts: Vec<_> =
        names.iter().enumerate().map(|(i, name)| file(name, &photograph(i))).collect();
    let capture = server.upload("/v1/captures", &parts, &[]).expect(201).json();
    let shown: Vec<&str> = { capture["images"].as_array().expect("assessments").iter() }
        .map(|image| image["name"].as_str().expect("a name"))
        .collect();
    assert_eq!(shown, ["cam0/0.png", "cam0/1.png", "cam1/0.png", "cam1/a\"b.png"]);
}

#[test]
fn every_photograph_has_a_thumbnail_and_its_original() {
    let server = Server::start();
    let zipped =
        zip(&[("a.png", photograph(1)), ("b.png", photograph(2)), ("c.png", photograph(3))]);
    let sent: Vec<_> = (0..4).map(photograph).collect();
    let original = |thumbnail: &str| thumbnail.replace("/thumbnails/", "/photographs/");
    let named: Vec<_> = { ["cam0/0.png", "cam1/0.png", "cam1/größe %.png"].iter().enumerate() }
        .map(|(i, name)| file(name, &photograph(i)))
        .collect();
    for parts in [vec![file("walk.zip", &zipped)], named] {
        let capture = server.upload("/v1/captures", &parts, &[]).expect(201).json();
        let base = format!("/v1/captures/{}/thumbnails", capture["id"].as_str().expect("id"));
        for image in capture["images"].as_array().expect("assessments") {
            let name = image["name"].as_str().expect("a name");
            let name = name.replace('%', "%25").replace(' ', "%20").replace('ö', "%C3%B6");
            let picture_at = format!("{base}/{}", name.replace('ß', "%C3%9F"));
            let picture = server.get(&picture_at, &[]).expect(200);
            assert_eq!(picture.header("content-type"), "image/jpeg");
            let path = server.data.path().join("thumbnail.jpg");
            std::fs::write(&path, &picture.body).expect("written");
            let small = Image::load(&path).expect("a picture");
            assert!(small.width().max(small.height()) <= 240);
            let whole = server.get(&original(&picture_at), &[]).expect(200);
            assert_eq!(whole.header("content-type"), "image/png");
            assert!(sent.contains(&whole.body), "as it was sent");
            let [brightness, sharpness] =
                ["brightness", "sharpness"].map(|key| image[key].as_f64().expect("reported"));
            assert!((0.0..=1.0).contains(&brightness) && sharpness > 0.0, "{image}");
        }
        for other in ["d.png", "..%2F..%2F..%2Ffled.db", "%2Fetc%2Fpasswd"] {
            let at = format!("{base}/{other}");
            server.get(&at, &[]).expect(404);
            server.get(&original(&at), &[]).expect(404);
        }
    }
    let nowhere = "/v1/captures/0190a1de-0000-7000-8000-000000000000/thumbnails/a.png";
    server.get(nowhere, &[]).expect(404);
}

#[test]
fn photographs_of_a_zip_take_turns_with_exports() {
    let server = Server::start_with(&[("FLED_FAKE_EXPORTS", "0")]);
    let made = || ["a.png", "b.png", "c.png"].iter().zip((0..3).map(photograph));
    let zipped = zip(&made().map(|(name, bytes)| (*name, bytes)).collect::<Vec<_>>());
    let loose: Vec<_> = made().map(|(name, bytes)| file(name, &bytes)).collect();
    let original = |parts: &[_]| {
        let capture = server.upload("/v1/captures", parts, &[]).expect(201).json();
        format!("/v1/captures/{}/photographs/a.png", capture["id"].as_str().expect("id"))
    };
    let busy = server.get(&original(&[file("walk.zip", &zipped)]), &[]).expect(503);
    assert_eq!(busy.json()["code"], "busy");
    assert!(!busy.header("retry-after").is_empty());
    server.get(&original(&loose), &[]).expect(200);
}

#[test]
fn ambiguous_poses_are_refused_naming_both_photographs() {
    let server = Server::start();
    let frame = |name: &str| {
        let matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]];
        serde_json::json!({ "file_path": name, "transform_matrix": matrix })
    };
    let frames = ["0.png", "1.png"].map(frame);
    let poses = serde_json::json!({ "fl_x": 70, "w": 80, "h": 60, "frames": frames }).to_string();
    let mut parts: Vec<_> = { ["cam0/0.png", "cam1/0.png", "cam1/1.png"].iter().enumerate() }
        .map(|(i, name)| file(name, &photograph(i)))
        .collect();
    let name = Some("transforms.json".to_owned());
    parts.push(("poses".to_owned(), name, poses.into_bytes()));
    let problem = server.upload("/v1/captures", &parts, &[]).expect(422).json();
    let detail = problem["detail"].as_str().expect("a detail");
    assert!(detail.contains("`cam0/0.png` and `cam1/0.png`"), "{detail}");
}

#[test]
fn several_places_are_reported_as_for_a_folder() {
    let server = Server::start();
    let parts: Vec<_> = { ["garden/0.png", "garden/1.png", "kitchen/0.png"].iter().enumerate() }
        .map(|(i, name)| file(name, &photograph(i)))
        .collect();
    let problem = server.upload("/v1/captures", &parts, &[]).expect(422).json();
    let detail = problem["detail"].as_str().expect("a detail");
    assert!(detail.contains("garden/ (2 pictures) and kitchen/ (1 picture)"), "{detail}");
    assert!(problem["hint"].as_str().is_some_and(|hint| hint.contains("images/")), "{problem}");
}
