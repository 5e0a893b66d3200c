//! Resumable uploads by the tus protocol, through a real server process.

use std::fs;
use std::io::Write;
use std::thread::sleep;
use std::time::{Duration, Instant};

use crate::support::Server;
use crate::support::tokens::token_of;
use crate::support::tus::{NAMED, PIECE, Tus, base64, status};

/// Counts the files of uploads.
fn files(server: &Server) -> usize {
    let folder = server.data.path().join("data/uploads");
    fs::read_dir(folder).expect("folder").count()
}

/// Waits until this many bytes of an upload are on disk, without asking the server.
fn wait_for_bytes(server: &Server, path: &str, bytes: u64) {
    let file = path.replace("/v1/uploads/", "data/uploads/");
    let file = server.data.path().join(file);
    let start = Instant::now();
    while fs::metadata(&file).is_ok_and(|about| about.len() < bytes) {
        assert!(start.elapsed() < Duration::from_secs(20), "{path}");
        sleep(Duration::from_millis(10));
    }
}

#[test]
fn options_describe_the_protocol_and_need_no_token() {
    let server = Server::start();
    let (_, _) = token_of("anna", &server, "jobs:write");
    for path in ["/v1/uploads", "/v1/uploads/any"] {
        // Clients that send no version get an answer too.
        let answer = server.ask("OPTIONS", path, &[], b"").expect(204);
        for (name, value) in
            [("tus-resumable", "1.0.0"), ("tus-version", "1.0.0"), ("tus-max-size", "1073741824")]
        {
            assert_eq!(answer.header(name), value, "{name}");
        }
        for extension in ["creation", "creation-with-upload", "expiration", "termination"] {
            let mut answer = answer.header("tus-extension").split(',');
            assert!(answer.any(|known| known == extension), "{extension}");
        }
        server.ask("HEAD", path, &[], b"").expect(401);
    }
}

#[test]
fn an_unsupported_version_is_refused_without_effect() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 3);
    for version in [&[][..], &[("tus-resumable", "0.2.2")]] {
        let length = [version, &[NAMED, ("upload-length", "3")]].concat();
        let offset = [version, &[PIECE, ("upload-offset", "0")]].concat();
        for (method, path, headers, body) in [
            ("POST", "/v1/uploads", &length, &b""[..]),
            ("HEAD", &path, &version.to_vec(), b""),
            ("PATCH", &path, &offset, b"abc"),
            ("DELETE", &path, &version.to_vec(), b""),
        ] {
            let refused = server.ask(method, path, headers, body).expect(412);
            assert_eq!(refused.header("tus-version"), "1.0.0", "{method}");
            assert_eq!(refused.header("tus-resumable"), "1.0.0", "{method}");
        }
    }
    assert_eq!((tus.offset(&path), files(&server)), (0, 1));
}

#[test]
fn an_upload_arrives_in_pieces_and_reports_its_offset() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let metadata = format!("filename {},kind ,is_dark", base64("a b.png".as_bytes()));
    let headers = [("upload-length", "11"), ("upload-metadata", &*metadata)];
    let begun = tus.ask("POST", "/v1/uploads", &headers, b"").expect(201);
    assert!(begun.header("upload-expires").ends_with(" GMT"));
    let path = begun.location();
    let answer = tus.head(&path).expect(200);
    for (name, value) in [
        ("upload-offset", "0"),
        ("upload-length", "11"),
        ("upload-metadata", &*metadata),
        ("cache-control", "no-store"),
    ] {
        assert_eq!(answer.header(name), value, "{name}");
    }
    let first = tus.patch(&path, 0, b"hello ").expect(204);
    assert_eq!(first.header("upload-offset"), "6");
    assert!(first.header("upload-expires").ends_with(" GMT"));
    for wrong in [0, 5, 7, 11, 12] {
        let refused = tus.patch(&path, wrong, b"world").expect(409);
        assert_eq!(refused.json()["code"], "wrong_offset", "{wrong}");
    }
    let empty = tus.patch(&path, 6, b"").expect(204);
    assert_eq!(empty.header("upload-offset"), "6");
    let last = tus.patch(&path, 6, b"world").expect(204);
    assert_eq!(last.header("upload-offset"), "11");
    // It is finished: nothing can be added, and an empty piece is accepted.
    tus.patch(&path, 11, b"").expect(204);
    tus.patch(&path, 11, b"!").expect(413);
    tus.patch(&path, 0, b"!").expect(409);
    assert_eq!(tus.offset(&path), 11);
    let file = path.replace("/v1/uploads/", "data/uploads/");
    let content = fs::read(server.data.path().join(file)).expect("there");
    assert_eq!(content, b"hello world");
}

#[test]
fn an_invalid_upload_is_refused_before_it_begins() {
    let server = Server::start_with(&[("FLED_FAKE_UPLOAD_BYTES", "1000")]);
    let tus = Tus::new(&server);
    let long = format!("filename d2Fsay5wbmc=,x {}", "A".repeat(8192));
    let length = ("upload-length", "5");
    for (status, headers) in [
        (400, vec![NAMED]),
        (400, vec![NAMED, ("upload-length", "-1")]),
        (400, vec![NAMED, ("upload-length", "5e3")]),
        (422, vec![NAMED, ("upload-defer-length", "1")]),
        (422, vec![NAMED, length, ("upload-concat", "partial")]),
        (422, vec![length]),
        (422, vec![length, ("upload-metadata", "filename")]),
        (400, vec![length, ("upload-metadata", "filename !")]),
        (422, vec![length, ("upload-metadata", "filename YQBiLnBuZw==")]),
        (422, vec![length, ("upload-metadata", &long)]),
        (413, vec![NAMED, ("upload-length", "1001")]),
    ] {
        let refused = tus.ask("POST", "/v1/uploads", &headers, b"");
        assert_eq!(refused.status, status, "{headers:?}: {}", refused.text());
        assert!(refused.json()["hint"].is_string(), "{}", refused.text());
    }
    assert_eq!(files(&server), 0);
    let path = tus.create("a.png", 1000);
    let offset = ("upload-offset", "0");
    tus.ask("PATCH", &path, &[offset], b"a").expect(415);
    let kind = ("content-type", "application/octet-stream");
    tus.ask("PATCH", &path, &[offset, kind], b"a").expect(415);
    tus.ask("PATCH", &path, &[PIECE], b"a").expect(400);
    let negative = ("upload-offset", "-0");
    tus.ask("PATCH", &path, &[PIECE, negative], b"a").expect(400);
    tus.ask("GET", &path, &[], b"").expect(405);
    tus.ask("POST", &path, &[], b"").expect(405);
    for method in ["HEAD", "PATCH", "DELETE"] {
        let headers = [PIECE, offset];
        tus.ask(method, "/v1/uploads/none", &headers, b"").expect(404);
    }
    assert_eq!(tus.offset(&path), 0);
}

#[test]
fn a_piece_beyond_the_length_changes_nothing() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 5);
    tus.patch(&path, 0, b"ab").expect(204);
    let refused = tus.patch(&path, 2, b"cdef").expect(413);
    assert_eq!(refused.json()["code"], "too_large");
    // Without a length the excess is noticed as it arrives.
    let address = server.base.trim_start_matches("http://");
    let mut stream = std::net::TcpStream::connect(address).expect("connect");
    write!(
        stream,
        "PATCH {path} HTTP/1.1\r\nHost: {address}\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 2\r\n\
         Content-Type: application/offset+octet-stream\r\nTransfer-Encoding: chunked\r\n\r\n2\r\ncd\r\n"
    )
    .expect("head");
    wait_for_bytes(&server, &path, 4);
    stream.write_all(b"4\r\nefgh\r\n0\r\n\r\n").expect("rest");
    assert_eq!(status(&mut stream), "413");
    assert_eq!(tus.offset(&path), 2);
    tus.patch(&path, 2, b"cde").expect(204);
}

#[test]
fn an_empty_upload_is_finished_at_once() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("empty.txt", 0);
    let answer = tus.head(&path).expect(200);
    assert_eq!(answer.header("upload-offset"), answer.header("upload-length"));
    tus.patch(&path, 0, b"").expect(204);
}

#[test]
fn the_creation_request_may_contain_the_first_piece() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let length = ("upload-length", "5");
    let begin = |headers: &[(&str, &str)], body: &[u8]| {
        let headers = [headers, &[NAMED, length]].concat();
        tus.ask("POST", "/v1/uploads", &headers, body)
    };
    let begun = begin(&[PIECE], b"abc").expect(201);
    assert_eq!(begun.header("upload-offset"), "3");
    let path = begun.location();
    tus.patch(&path, 3, b"de").expect(204);
    begin(&[], b"abc").expect(415);
    begin(&[("content-type", "text/plain")], b"abc").expect(415);
    begin(&[PIECE], b"abcdef").expect(413);
    assert_eq!(files(&server), 1, "nothing was begun");
}

#[test]
fn data_received_before_a_disconnect_is_kept() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 10);
    let stream = tus.hanging(&path, "Upload-Offset: 0\r\n", 10, b"abcd");
    wait_for_bytes(&server, &path, 4);
    drop(stream);
    assert_eq!(tus.offset(&path), 4);
    tus.patch(&path, 4, b"efghij").expect(204);
}

#[test]
fn a_stalled_sender_times_out_and_its_data_is_kept() {
    let server = Server::start_with(&[("FLED_FAKE_STALL_MS", "300")]);
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 10);
    let mut asleep = tus.hanging(&path, "Upload-Offset: 0\r\n", 10, b"abcd");
    assert_eq!(status(&mut asleep), "400");
    assert_eq!(tus.offset(&path), 4);
}

#[test]
fn a_returning_client_takes_over_its_upload() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 12);
    let mut hung = tus.hanging(&path, "Upload-Offset: 0\r\n", 12, b"abcd");
    wait_for_bytes(&server, &path, 4);
    let start = Instant::now();
    assert_eq!(tus.offset(&path), 4);
    assert!(start.elapsed() < Duration::from_secs(5), "it hangs, too");
    assert_eq!(status(&mut hung), "409");
    // Data that the old connection still sends is discarded.
    let _ = hung.write_all(b"XXXXXXXX");
    sleep(Duration::from_millis(200));
    assert_eq!(tus.offset(&path), 4);
    let mut hung = tus.hanging(&path, "Upload-Offset: 4\r\n", 8, b"ef");
    wait_for_bytes(&server, &path, 6);
    tus.patch(&path, 6, b"ghijkl").expect(204);
    assert_eq!(status(&mut hung), "409");
    let file = path.replace("/v1/uploads/", "data/uploads/");
    let content = fs::read(server.data.path().join(file)).expect("there");
    assert_eq!(content, b"abcdefghijkl");
}

#[test]
fn a_deleted_upload_is_gone_for_waiting_requests() {
    let server = Server::start();
    let tus = Tus::new(&server);
    for _ in 0..10 {
        let path = tus.create("a.png", 12);
        let hung = tus.hanging(&path, "Upload-Offset: 0\r\n", 12, b"abcd");
        wait_for_bytes(&server, &path, 4);
        std::thread::scope(|scope| {
            let heads: Vec<_> = (0..3).map(|_| scope.spawn(|| tus.head(&path).status)).collect();
            tus.ask("DELETE", &path, &[], b"").expect(204);
            for head in heads {
                let status = head.join().expect("an answer");
                assert!([200, 404].contains(&status), "{status}");
            }
        });
        drop(hung);
        for method in ["HEAD", "DELETE"] {
            tus.ask(method, &path, &[], b"").expect(404);
        }
        tus.patch(&path, 4, b"e").expect(404);
    }
    assert_eq!(files(&server), 0);
}

#[test]
fn an_upload_expires_some_time_after_its_last_byte() {
    let short = [("FLED_FAKE_UPLOAD_MS", "2000")];
    let mut server = Server::start_with(&short);
    let tus = Tus::new(&server);
    let (left, sent) = (tus.create("a.png", 4), tus.create("b.png", 4));
    sleep(Duration::from_millis(1300));
    tus.patch(&sent, 0, b"a").expect(204);
    sleep(Duration::from_millis(1000));
    tus.head(&left).expect(404);
    tus.patch(&left, 0, b"a").expect(404);
    tus.patch(&sent, 1, b"b").expect(204);
    assert_eq!(tus.offset(&sent), 2);
    assert_eq!(files(&server), 2);
    server.restart_with(&short);
    assert_eq!(files(&server), 1, "the expired one is gone");
    assert_eq!(Tus::new(&server).offset(&sent), 2);
}

#[test]
fn a_killed_server_knows_the_offset_of_an_upload() {
    let mut server = Server::start();
    let content: Vec<u8> = (0..3_000_000_u32).map(|i| (i % 251) as u8).collect();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", content.len());
    tus.patch(&path, 0, &content[..1000]).expect(204);
    let some = &content[1000..1_500_000];
    let rest = content.len() - 1000;
    let stream = tus.hanging(&path, "Upload-Offset: 1000\r\n", rest, some);
    wait_for_bytes(&server, &path, 100_000);
    server.kill();
    drop(stream);
    server.restart();
    let tus = Tus::new(&server);
    let offset = tus.offset(&path);
    let file = path.replace("/v1/uploads/", "data/uploads/");
    let file = server.data.path().join(file);
    let there = fs::read(&file).expect("there");
    assert!(offset >= 100_000 && there == content[..offset], "{offset}");
    tus.patch(&path, offset, &content[offset..]).expect(204);
    assert!(fs::read(&file).expect("there") == content);
}

#[test]
fn a_post_can_override_its_method() {
    let server = Server::start();
    let tus = Tus::new(&server);
    let path = tus.create("a.png", 3);
    let by = |method| ("x-http-method-override", method);
    let offset = ("upload-offset", "0");
    tus.ask("POST", &path, &[by("PATCH"), PIECE, offset], b"abc").expect(204);
    let answer = tus.ask("POST", &path, &[by("HEAD")], b"").expect(200);
    assert_eq!(answer.header("upload-offset"), "3");
    tus.ask("POST", &path, &[by("PUT")], b"").expect(405);
    tus.ask("POST", &path, &[by("DELETE")], b"").expect(204);
    tus.head(&path).expect(404);
}

#[test]
fn the_number_of_uploads_of_an_owner_is_limited() {
    let server = Server::start_with(&[("FLED_FAKE_UPLOADS", "2")]);
    let (anna, _) = token_of("anna", &server, "jobs:write");
    let (ben, _) = token_of("ben", &server, "jobs:write");
    let (annas, bens) = (Tus::of(&server, &anna), Tus::of(&server, &ben));
    let first = annas.create("a.png", 1);
    annas.upload("b.png", b"b");
    let refused = annas.begin("c.png", 1).expect(429);
    assert_eq!(refused.json()["code"], "too_many_uploads");
    bens.create("c.png", 1);
    annas.ask("DELETE", &first, &[], b"").expect(204);
    annas.create("c.png", 1);
    assert_eq!(files(&server), 3);
}

#[test]
fn pieces_cost_little_of_the_rate_limit() {
    let server = Server::start_with(&[("FLED_FAKE_RATE", "1"), ("FLED_FAKE_BURST", "100")]);
    let (anna, _) = token_of("anna", &server, "jobs:write");
    let tus = Tus::of(&server, &anna);
    let path = tus.create("a.png", 40);
    for offset in 0..40 {
        tus.patch(&path, offset, b"a").expect(204);
    }
    let pieces = (0..40).map(|_| tus.patch(&path, 40, b"").status);
    assert!(pieces.into_iter().any(|status| status == 429), "they cost");
}

#[test]
fn below_the_watermark_no_piece_is_accepted() {
    let mut server = Server::start();
    let path = Tus::new(&server).create("a.png", 4);
    Tus::new(&server).patch(&path, 0, b"a").expect(204);
    server.restart_with(&[("FLED_FAKE_MIN_FREE", "1152921504606846976")]);
    let tus = Tus::new(&server);
    let refused = tus.begin("b.png", 4).expect(507);
    assert_eq!(refused.json()["code"], "disk_full");
    tus.patch(&path, 1, b"bcd").expect(507);
    assert_eq!((tus.offset(&path), files(&server)), (1, 1));
}

#[test]
fn an_upload_for_a_job_is_refused_while_there_is_no_room_for_one() {
    let server = Server::start_with(&[("FLED_FAKE_QUEUE", "0")]);
    let tus = Tus::new(&server);
    let for_a = |purpose: &str| {
        let metadata = format!("{},for {}", NAMED.1, base64(purpose.as_bytes()));
        let headers = [(NAMED.0, &*metadata), ("upload-length", "1")];
        tus.ask("POST", "/v1/uploads", &headers, b"")
    };
    let refused = for_a("job").expect(503);
    assert_eq!(refused.json()["code"], "queue_full");
    assert_eq!((refused.header("retry-after"), files(&server)), ("60", 0));
    for_a("capture").expect(201);
    tus.create("a.png", 1);
}
