//! Remains of disconnected clients and killed servers on disk, through a real server process.

use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::{Server, deflated, photograph};

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("folder").flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn uploads_of_disconnected_clients_leave_nothing() {
    let server = Server::start();
    let data = server.data.path().join("data");
    let files: Vec<(String, Vec<u8>)> =
        (0..12).map(|i| (format!("images/{i}.png"), photograph(i))).collect();
    let files: Vec<(&str, Vec<u8>)> = files.iter().map(|(n, c)| (n.as_str(), c.clone())).collect();
    let mut body = b"--XXXX\r\nContent-Disposition: form-data; name=\"images\"; \
        filename=\"a.zip\"\r\n\r\n"
        .to_vec();
    body.extend(deflated(&files));
    body.extend(b"\r\n--XXXX--\r\n");
    let address = server.base.trim_start_matches("http://").to_owned();
    for i in 0..40 {
        let mut stream = TcpStream::connect(&address).expect("connect");
        let head = format!(
            "POST /v1/captures HTTP/1.1\r\nHost: {address}\r\nContent-Length: {}\r\n\
             Content-Type: multipart/form-data; boundary=XXXX\r\n\r\n",
            body.len()
        );
        stream.write_all(head.as_bytes()).expect("head");
        stream.write_all(&body).expect("body");
        // Disconnect before, during and after the validation.
        sleep(Duration::from_millis(3 * i));
    }
    let start = Instant::now();
    while !names(&data.join("incoming")).is_empty() {
        let left = names(&data.join("incoming"));
        assert!(start.elapsed() < Duration::from_secs(10), "left: {left:?}");
        sleep(Duration::from_millis(100));
    }
    // The files of the last capture exist shortly before its row.
    let listed = || {
        let listed = server.get("/v1/captures?limit=200", &[]).expect(200).json();
        listed["captures"].as_array().expect("captures").len()
    };
    while names(&data.join("captures")).len() != listed() {
        assert!(start.elapsed() < Duration::from_secs(10), "files without a row");
        sleep(Duration::from_millis(100));
    }
}

#[test]
fn a_restart_moves_orphans_aside_and_keeps_the_rest() {
    let mut server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    server.get(&format!("/v1/jobs/{job}/render?azimuth=1"), &[]).expect(200);
    let data = server.data.path().join("data");
    let (captures, jobs) = (names(&data.join("captures")), names(&data.join("jobs")));
    let renders = data.join("jobs").join(&job).join("renders");
    let pictures = names(&renders);
    server.kill();
    fs::create_dir_all(data.join("captures/left/images")).expect("made");
    fs::create_dir_all(data.join("jobs/left/output")).expect("made");
    fs::create_dir_all(data.join("incoming/left")).expect("made");
    fs::write(renders.join("left.tmp"), "half a picture").expect("written");
    server.restart();
    assert_eq!(names(&data.join("captures")), captures);
    assert_eq!(names(&data.join("jobs")), jobs);
    assert_eq!(names(&renders), pictures);
    assert!(names(&data.join("incoming")).is_empty());
    server.get(&format!("/v1/jobs/{job}/artifacts/scene.ply"), &[]).expect(200);
}

#[test]
fn a_database_restored_from_an_older_backup_loses_no_capture() {
    let mut server = Server::start();
    let old = server.job("ok");
    server.wait_state(&old, "succeeded");
    let data = server.data.path().join("data");
    server.kill();
    let aside = server.data.path().join("aside");
    let databases = ["fled.db", "fled.db-wal", "fled.db-shm"];
    let copy = |from: &Path, to: &Path| {
        for name in databases {
            if fs::copy(from.join(name), to.join(name)).is_err() {
                // Only some databases have a log file.
                let _ = fs::remove_file(to.join(name));
            }
        }
    };
    let (older, newer) = (aside.join("older"), aside.join("newer"));
    fs::create_dir_all(&older).expect("made");
    fs::create_dir_all(&newer).expect("made");
    copy(&data, &older);
    server.restart();
    let job = server.job("ok");
    let shown = server.wait_state(&job, "succeeded");
    let capture = shown["capture_id"].as_str().expect("id").to_owned();
    server.kill();
    copy(&data, &newer);
    copy(&older, &data);
    server.restart();
    server.get(&format!("/v1/jobs/{job}"), &[]).expect(404);
    server.get(&format!("/v1/jobs/{old}"), &[]).expect(200);
    let unnamed = data.join("unnamed");
    assert_eq!(names(&unnamed.join("captures")), std::slice::from_ref(&capture));
    assert_eq!(names(&unnamed.join("jobs")), std::slice::from_ref(&job));
    assert!(!data.join("jobs").join(&job).exists());
    // As the log advises: the right database, and the folders moved back.
    server.kill();
    copy(&newer, &data);
    for (kind, id) in [("captures", &capture), ("jobs", &job)] {
        fs::rename(unnamed.join(kind).join(id), data.join(kind).join(id)).expect("back");
    }
    server.restart();
    let scene = format!("/v1/jobs/{job}/artifacts/scene.ply");
    server.get(&scene, &[]).expect(200);
    let kept = data.join("captures").join(&capture);
    assert!(!names(&kept).is_empty(), "the photographs are there");
}
