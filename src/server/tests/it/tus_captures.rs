//! Captures and jobs from resumable uploads, through a real server process.

use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::tokens::{token_of, token_with, with_store};
use crate::support::tus::{Tus, status};
use crate::support::{Server, photograph, photographs, zip};
use fled_server::store::Quotas;
use serde_json::{Value, json};

/// The scopes of a user.
const USER: &str = "jobs:read,jobs:write,renders";

/// Uploads `n` photographs.
fn uploads(tus: &Tus<'_>, n: usize) -> Vec<String> {
    let upload = |i| tus.upload(&format!("{i:03}.png"), &photograph(i));
    (0..n).map(upload).collect()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("folder").flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn count(server: &Server, list: &str) -> usize {
    let listed = server.get(&format!("/v1/{list}"), &[]).expect(200).json();
    listed[list].as_array().expect("a list").len()
}

fn path(id: &str) -> String {
    format!("/v1/uploads/{id}")
}

#[test]
fn resumable_uploads_of_photographs_become_a_capture() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let mut ids = uploads(&tus, 4);
    ids.push(tus.upload("../gt/../gt/000.png", &photograph(9)));
    ids.push(tus.upload("notes.jpg", b"no photograph"));
    ids.push(tus.upload("../../000.png", &photograph(7)));
    let data = server.data.path().join("data");
    let order = json!({ "uploads": ids, "name": "in pieces" });
    let dry = server.post_json("/v1/captures?dry_run", &order, &[]);
    assert_eq!(dry.expect(200).json()["accepted"], 5);
    assert_eq!(names(&data.join("uploads")).len(), 7, "nothing is used up");
    let made = server.post_json("/v1/captures", &order, &[]).expect(201);
    let capture = made.json();
    assert_eq!((&capture["name"], &capture["accepted"]), (&"in pieces".into(), &5.into()));
    assert_eq!(made.location(), format!("/v1/captures/{}", capture["id"].as_str().expect("id")));
    let kept = data.join("captures").join(capture["id"].as_str().expect("id"));
    assert_eq!(names(&kept), [".names.json", ".thumbnails", "gt", "images"]);
    assert_eq!(
        names(&kept.join("images")),
        ["000-2.png", "000.png", "001.png", "002.png", "003.png", "notes.jpg"]
    );
    assert!(fs::read(kept.join("images/002.png")).expect("there") == photograph(2));
    assert!(names(&data.join("uploads")).is_empty() && names(&data.join("incoming")).is_empty());
    for id in &ids {
        tus.head(&path(id)).expect(404);
    }
    let again = server.post_json("/v1/captures", &order, &[]).expect(404);
    assert_eq!(again.json()["pointer"], "/uploads/0");
}

#[test]
fn a_resumable_upload_of_a_zip_becomes_a_capture() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let content: Vec<(&str, Vec<u8>)> = (0..)
        .zip(["images/a.png", "images/b.png", "images/c.png"])
        .map(|(i, name)| (name, photograph(i)))
        .collect();
    let id = tus.upload("walk.zip", &zip(&content));
    let order = json!({ "uploads": [id] });
    let made = server.post_json("/v1/captures", &order, &[]).expect(201).json();
    assert_eq!(made["accepted"], 3);
    let kept = server.data.path().join("data/captures");
    let kept = kept.join(made["id"].as_str().expect("id"));
    assert_eq!(names(&kept), [".thumbnails", "upload.zip"]);
}

#[test]
fn photographs_are_added_to_those_of_a_capture_which_stays_as_it_is() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let content: Vec<(String, Vec<u8>)> =
        (0..3).map(|i| (format!("walk/{i:03}.png"), photograph(i))).collect();
    let content: Vec<_> = content.iter().map(|(name, bytes)| (&**name, bytes.clone())).collect();
    let archive = tus.upload("walk.zip", &zip(&content));
    let captures = server.data.path().join("data/captures");
    for of in [uploads(&tus, 3), vec![archive]] {
        let order = json!({ "uploads": of });
        let first = server.post_json("/v1/captures", &order, &[]).expect(201).json();
        let first = first["id"].as_str().expect("id");
        let [more, same] =
            [("003.png", 3), ("000.png", 4)].map(|(name, i)| tus.upload(name, &photograph(i)));
        let order = json!({ "uploads": [more, same], "add_to": first });
        let both = server.post_json("/v1/captures", &order, &[]).expect(201).json();
        assert_eq!(both["accepted"], 5, "{both}");
        let images = captures.join(both["id"].as_str().expect("id")).join("images");
        let held = names(&images).into_iter().map(|name| fs::read(images.join(name)));
        let mut held: Vec<_> = held.collect::<Result<_, _>>().expect("readable");
        let mut expected: Vec<_> = (0..5).map(photograph).collect();
        held.sort();
        expected.sort();
        assert!(held == expected, "each photograph once: {}", held.len());
        let first = server.get(&format!("/v1/captures/{first}"), &[]).expect(200).json();
        assert_eq!(first["accepted"], 3);
    }
}

#[test]
fn a_zip_or_a_video_is_not_added_to_a_capture() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let order = json!({ "uploads": uploads(&tus, 3) });
    let first = server.post_json("/v1/captures", &order, &[]).expect(201).json();
    for name in ["walk.ZIP", "walk.mp4"] {
        let id = tus.upload(name, &photograph(3));
        let order = json!({ "uploads": [id], "add_to": first["id"] });
        let refused = server.post_json("/v1/captures", &order, &[]).expect(422).json();
        assert_eq!(refused["pointer"], "/add_to", "{name}");
    }
}

#[test]
fn photographs_are_added_to_own_captures_alone() {
    let server = Server::start();
    let [anna, bert] = ["anna", "bert"].map(|name| token_of(name, &server, USER).0);
    let order = |tus: &Tus<'_>| json!({ "uploads": uploads(tus, 3) });
    let ours = order(&Tus::of(&server, &anna));
    let headers = [("authorization", anna.as_str())];
    let capture = server.post_json("/v1/captures", &ours, &headers).expect(201).json();
    for id in [capture["id"].clone(), "none".into(), "../captures".into()] {
        let mut order = order(&Tus::of(&server, &bert));
        order["add_to"] = id;
        for path in ["/v1/captures", "/v1/jobs"] {
            let headers = [("authorization", bert.as_str())];
            let refused = server.post_json(path, &order, &headers).expect(404).json();
            assert_eq!(refused["pointer"], "/add_to");
        }
    }
}

#[test]
fn uploads_become_at_most_one_job_per_key() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let ids = uploads(&tus, 4);
    let order = json!({
        "uploads": ids, "name": "walk", "preset": "preview", "options": { "adapter": "ok" },
    });
    let key = [("idempotency-key", "walk")];
    let made = server.post_json("/v1/jobs", &order, &key).expect(202);
    assert_eq!(made.header("idempotent-replayed"), "");
    let job = made.json();
    assert_eq!((&job["name"], &job["preset"]), (&"walk".into(), &"preview".into()));
    // As if the answer was lost: the uploads are used up.
    let again = server.post_json("/v1/jobs", &order, &key).expect(202);
    assert_eq!(again.header("idempotent-replayed"), "true");
    assert_eq!(again.json()["id"], job["id"]);
    let mut other = order.clone();
    other["name"] = "another".into();
    let refused = server.post_json("/v1/jobs", &other, &key).expect(422);
    assert_eq!(refused.json()["code"], "key_reused");
    server.post_json("/v1/jobs", &order, &[]).expect(404);
    assert_eq!((count(&server, "captures"), count(&server, "jobs")), (1, 1));
    server.wait_state(job["id"].as_str().expect("id"), "succeeded");
}

#[test]
fn concurrent_identical_requests_create_one_job() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let order = json!({ "uploads": uploads(&tus, 4), "options": { "adapter": "ok" } });
    let key = [("idempotency-key", "walk")];
    let jobs: Vec<Value> = std::thread::scope(|scope| {
        let ask = || server.post_json("/v1/jobs", &order, &key).expect(202).json();
        let asked: Vec<_> = (0..4).map(|_| scope.spawn(ask)).collect();
        let answers = asked.into_iter().map(|answer| answer.join().expect("202"));
        answers.map(|job| job["id"].clone()).collect()
    });
    assert!(jobs.iter().all(|job| *job == jobs[0]), "{jobs:?}");
    assert_eq!((count(&server, "captures"), count(&server, "jobs")), (1, 1));
    let captures = server.data.path().join("data/captures");
    assert_eq!(names(&captures).len(), 1, "files without a row");
}

#[test]
fn uploads_stay_until_they_are_used() {
    let server = Server::start_with(&[("FLED_FAKE_QUEUE", "1")]);
    let tus = Tus::new(&server);
    let ids = uploads(&tus, 4);
    let half = tus.create("half.png", 100);
    tus.patch(&half, 0, b"abc").expect(204);
    let half = half.trim_start_matches("/v1/uploads/");
    let text = tus.upload("notes.jpg", b"no photograph");
    let refused = |uploads: Value, status: u16| {
        let mut problem = json!(null);
        for path in ["/v1/captures", "/v1/jobs"] {
            let order = json!({ "uploads": uploads });
            problem = server.post_json(path, &order, &[]).expect(status).json();
        }
        problem
    };
    let unfinished = refused(json!([ids[0], half]), 409);
    assert_eq!(unfinished["code"], "unfinished");
    assert_eq!(unfinished["pointer"], "/uploads/1");
    assert_eq!(refused(json!([ids[0], "none"]), 404)["pointer"], "/uploads/1");
    assert_eq!(refused(json!([ids[0], ids[0]]), 422)["pointer"], "/uploads/1");
    assert_eq!(refused(json!([ids[0], "../fled.db"]), 404)["pointer"], "/uploads/1");
    refused(json!([]), 422);
    refused(json!("none"), 422);
    let few = refused(json!([ids[0], ids[1], text]), 422);
    assert!(few["capture"]["images"].as_array().is_some_and(|v| v.len() == 3));
    let long = json!({ "uploads": ids, "name": "x".repeat(201) });
    server.post_json("/v1/captures", &long, &[]).expect(422);
    let both = json!({ "uploads": ids, "capture_id": "c" });
    server.post_json("/v1/jobs", &both, &[]).expect(422);
    let wrong = json!({ "uploads": ids, "options": { "rounds": "many" } });
    server.post_json("/v1/jobs", &wrong, &[]).expect(422);
    assert_eq!((count(&server, "captures"), count(&server, "jobs")), (0, 0));
    let folder = server.data.path().join("data");
    assert_eq!(names(&folder.join("uploads")).len(), 6);
    // The refusal is sent before its folder is removed.
    let answered = Instant::now();
    while !names(&folder.join("incoming")).is_empty() && answered.elapsed().as_secs() < 5 {
        sleep(Duration::from_millis(10));
    }
    assert!(names(&folder.join("incoming")).is_empty());
    assert!(names(&folder.join("captures")).is_empty());
    let order = json!({ "uploads": ids, "options": { "adapter": "slow:1000" } });
    server.post_json("/v1/jobs", &order, &[]).expect(202);
}

#[test]
fn a_job_without_room_uses_no_uploads() {
    let server = Server::start();
    let quotas = Quotas { jobs: Some(1), ..Quotas::default() };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let tus = Tus::of(&server, &anna);
    let orders = [0, 1]
        .map(|_| json!({ "uploads": uploads(&tus, 4), "options": { "adapter": "slow:1000" } }));
    let headers = [("authorization", anna.as_str())];
    // Both pass the first check before one of them has its job.
    let mut statuses = std::thread::scope(|scope| {
        let asked = orders
            .each_ref()
            .map(|order| scope.spawn(|| server.post_json("/v1/jobs", order, &headers).status));
        asked.map(|answer| answer.join().expect("an answer"))
    });
    statuses.sort_unstable();
    assert_eq!(statuses, [202, 429]);
    let data = server.data.path().join("data");
    assert_eq!(names(&data.join("uploads")).len(), 4, "one may try again");
    assert_eq!(names(&data.join("captures")).len(), 1);
}

#[test]
fn an_upload_belongs_to_its_owner() {
    let server = Server::start();
    let nobodys = Tus::new(&server).upload("000.png", &photograph(0));
    let (anna, _) = token_of("anna", &server, USER);
    let (later, _) = token_of("anna", &server, "jobs:write");
    let (ben, _) = token_of("ben", &server, USER);
    let (admin, _) = token_of("root", &server, "admin");
    let (reads, _) = token_of("anna", &server, "jobs:read,renders");
    let ids = uploads(&Tus::of(&server, &anna), 4);
    let order = json!({ "uploads": ids });
    for (header, seen) in [(&ben, 404), (&reads, 403), (&admin, 200), (&later, 200)] {
        Tus::of(&server, header).head(&path(&ids[0])).expect(seen);
    }
    let bens = Tus::of(&server, &ben);
    bens.patch(&path(&ids[0]), 0, b"").expect(404);
    bens.ask("DELETE", &path(&ids[0]), &[], b"").expect(404);
    // Not even those who see the uploads may use them: the capture would count for another owner.
    for header in [&ben, &admin] {
        let headers = [("authorization", header.as_str())];
        for path in ["/v1/captures", "/v1/jobs"] {
            let refused = server.post_json(path, &order, &headers).expect(404);
            assert_eq!(refused.json()["pointer"], "/uploads/0");
        }
    }
    let headers = [("authorization", anna.as_str())];
    let stolen = json!({ "uploads": [ids[0], ids[1], ids[2], nobodys] });
    let refused = server.post_json("/v1/captures", &stolen, &headers);
    assert_eq!(refused.expect(404).json()["pointer"], "/uploads/3");
    Tus::of(&server, &anna).head(&path(&nobodys)).expect(404);
    server.post_json("/v1/captures", &order, &headers).expect(201);
}

#[test]
fn uploads_count_once_towards_their_owners_quota() {
    let server = Server::start();
    let bytes: usize = photographs(3).iter().map(|part| part.2.len()).sum();
    let quotas = Quotas { bytes: Some(bytes as u64), ..Quotas::default() };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let tus = Tus::of(&server, &anna);
    let headers = [("authorization", anna.as_str())];
    let refused = tus.begin("a.png", bytes + 1).expect(507);
    assert_eq!(refused.json()["code"], "quota_bytes");
    // The announced length counts before the data arrives.
    let announced = tus.create("a.png", bytes);
    tus.begin("b.png", 1).expect(507);
    let parts = photographs(3);
    let refused = server.upload("/v1/captures", &parts, &headers);
    assert_eq!(refused.expect(507).json()["code"], "quota_bytes");
    tus.ask("DELETE", &announced, &[], b"").expect(204);
    let ids = uploads(&tus, 3);
    tus.begin("b.png", 1).expect(507);
    // They fill the quota, and so does the capture made of them.
    let order = json!({ "uploads": ids });
    server.post_json("/v1/captures", &order, &headers).expect(201);
    tus.begin("b.png", 1).expect(507);
}

#[test]
fn uploads_together_are_limited_like_a_single_one() {
    let server = Server::start_with(&[("FLED_FAKE_UPLOAD_BYTES", "100000")]);
    let tus = Tus::new(&server);
    let ids = [0, 1].map(|_| tus.upload("a.zip", &[0; 60_000]));
    let order = json!({ "uploads": ids });
    let refused = server.post_json("/v1/captures", &order, &[]).expect(413);
    assert_eq!(refused.json()["code"], "too_large");
}

#[test]
fn an_upload_without_its_file_is_not_found() {
    let mut server = Server::start();
    let ids = uploads(&Tus::new(&server), 4);
    let folder = server.data.path().join("data/uploads");
    fs::remove_file(folder.join(&ids[1])).expect("removed");
    let tus = Tus::new(&server);
    tus.head(&path(&ids[1])).expect(404);
    tus.patch(&path(&ids[1]), 0, b"").expect(404);
    let order = json!({ "uploads": ids });
    let refused = server.post_json("/v1/captures", &order, &[]).expect(404);
    assert_eq!(refused.json()["pointer"], "/uploads/1");
    server.restart();
    let left = with_store(&server, async |store| store.ids("uploads").await);
    let mut left: Vec<String> = left.expect("read").into_iter().collect();
    left.sort();
    assert_eq!(left, [&ids[0][..], &ids[2], &ids[3]]);
}

#[test]
fn an_upload_without_a_row_is_moved_aside() {
    let mut server = Server::start();
    let tus = Tus::new(&server);
    let (finished, empty) = (tus.upload("a.png", b"abc"), tus.create("b.png", 3));
    let empty = empty.trim_start_matches("/v1/uploads/");
    // Like a database restored from an older backup.
    with_store(&server, async |store| {
        store.forget_uploads().await.expect("forgotten");
    });
    server.restart();
    let data = server.data.path().join("data");
    assert!(names(&data.join("uploads")).is_empty());
    let aside = names(&data.join("unnamed/uploads"));
    assert_eq!(aside, [finished], "{empty} is nothing to lose");
}

#[test]
fn a_backup_has_no_uploads() {
    let server = Server::start();
    let id = Tus::new(&server).upload("a.png", b"abc");
    let mut other = Server::start();
    other.kill();
    let (from, to) = (server.data.path().join("data"), other.data.path().join("data"));
    fs::remove_dir_all(&to).expect("removed");
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().expect("runtime");
    runtime.block_on(fled_server::backup(&from, &to)).expect("copied");
    other.restart();
    Tus::new(&other).head(&path(&id)).expect(404);
    assert_eq!(Tus::new(&server).offset(&path(&id)), 3);
}

#[test]
fn poses_with_equal_names_do_not_change_each_others_uploads() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let mut ids = uploads(&tus, 3);
    let files: [&[u8]; 2] = [b"a first file of poses, the longer one", b"a second"];
    ids.extend(files.map(|content| tus.upload("sparse/0/cameras.bin", content)));
    let order = json!({ "uploads": ids });
    server.post_json("/v1/captures?dry_run", &order, &[]);
    let folder = server.data.path().join("data/uploads");
    for (id, content) in ids[3..].iter().zip(files) {
        assert!(fs::read(folder.join(id)).expect("there") == content);
        assert_eq!(tus.offset(&path(id)), content.len());
    }
}

#[test]
fn an_unfinished_piece_does_not_change_a_capture() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let mut ids = uploads(&tus, 2);
    let photograph = photograph(2);
    let last = tus.create("002.png", photograph.len());
    let address = server.base.trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).expect("connect");
    let length = photograph.len();
    write!(
        stream,
        "PATCH {last} HTTP/1.1\r\nHost: {address}\r\nTus-Resumable: 1.0.0\r\n\
         Content-Type: application/offset+octet-stream\r\nUpload-Offset: 0\r\n\
         Transfer-Encoding: chunked\r\n\r\n{length:x}\r\n"
    )
    .expect("head");
    stream.write_all(&photograph).expect("all of it");
    stream.write_all(b"\r\n").expect("end of a chunk");
    let file = server.data.path().join("data").join(last.trim_start_matches("/v1/"));
    let start = Instant::now();
    while fs::metadata(&file).expect("there").len() < length as u64 {
        assert!(start.elapsed() < Duration::from_secs(20), "it does not come");
        sleep(Duration::from_millis(10));
    }
    ids.push(last.trim_start_matches("/v1/uploads/").to_owned());
    let made = server.post_json("/v1/captures", &json!({ "uploads": ids }), &[]);
    let capture = made.expect(201).json()["id"].clone();
    // One byte too many: the request is interrupted, because its upload is already used.
    let _ = stream.write_all(b"1\r\nx\r\n0\r\n\r\n");
    assert_eq!(status(&mut stream), "409", "another request has taken it over");
    let kept = server.data.path().join("data/captures");
    let kept = kept.join(capture.as_str().expect("id")).join("images/002.png");
    assert!(fs::read(kept).expect("there") == photograph);
}
