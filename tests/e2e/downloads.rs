//! `fled models fetch`, from a server of the test's own.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};

use fled_core::deblur::manifest::digest;

use crate::support::{code, models, network, said};

/// A server of one file, which breaks its first answer off after `cut` bytes; the requests' `range`
/// headers.
fn serve(content: Vec<u8>, cut: usize) -> (String, Arc<Mutex<Vec<Option<String>>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!(
        "http://{}/network.onnx",
        listener.local_addr().expect("bound")
    );
    let ranges = Arc::new(Mutex::new(Vec::new()));
    let seen = ranges.clone();
    std::thread::spawn(move || {
        for (count, stream) in listener.incoming().enumerate() {
            let Ok(stream) = stream else { continue };
            let range = answer(stream, &content, (count == 0).then_some(cut));
            seen.lock().expect("not poisoned").push(range);
        }
    });
    (url, ranges)
}

fn answer(mut stream: TcpStream, content: &[u8], cut: Option<usize>) -> Option<String> {
    let lines = BufReader::new(stream.try_clone().expect("a second handle")).lines();
    let head: Vec<String> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.is_empty())
        .collect();
    let range = head.iter().find_map(|line| {
        line.to_lowercase()
            .strip_prefix("range: ")
            .map(str::to_owned)
    });
    let from = range.as_deref().and_then(|range| {
        range
            .strip_prefix("bytes=")?
            .strip_suffix('-')?
            .parse()
            .ok()
    });
    let from: usize = from.unwrap_or(0);
    if from >= content.len() {
        let head =
            "HTTP/1.1 416 Range Not Satisfiable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        let _ = stream.write_all(head.as_bytes());
        return range;
    }
    let status = if from > 0 {
        format!(
            "206 Partial Content\r\nContent-Range: bytes {from}-{}/{}",
            content.len() - 1,
            content.len()
        )
    } else {
        "200 OK".to_owned()
    };
    let length = content.len() - from;
    let head =
        format!("HTTP/1.1 {status}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n");
    let sent = &content[from..cut.unwrap_or(content.len())];
    let _ = stream
        .write_all(head.as_bytes())
        .and_then(|()| stream.write_all(sent));
    range
}

/// A list that names the network at `url`.
fn overlay(folder: &Path, url: &str, sha256: &str, bytes: usize) {
    let entry = serde_json::json!({
        "id": "far", "role": "single", "file": "far.onnx", "url": url, "sha256": sha256, "bytes": bytes, "licence": "MIT",
        "channels": 3, "order": ["blurry"], "multiple": 16, "minimum_side": 16, "tile": 1024, "range": [-1.0, 2.0],
        "input": null, "output": null, "default": false, "verified": false,
    });
    let text = serde_json::json!({ "models": [entry] }).to_string();
    std::fs::write(folder.join("manifest.json"), text).expect("write");
}

#[test]
fn a_broken_download_goes_on_where_it_stopped() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), 100);
    overlay(home.path(), &url, &digest(&content), content.len());
    let broken = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&broken), 4, "{}", said(&broken));
    assert!(
        said(&broken).contains("stopped after 100"),
        "{}",
        said(&broken)
    );
    assert!(
        !home.path().join("far.onnx").exists(),
        "only a whole file may be found"
    );
    let whole = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&whole), 0, "{}", said(&whole));
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
    assert_eq!(
        *ranges.lock().expect("not poisoned"),
        [None, Some("bytes=100-".to_owned())]
    );
    assert!(!home.path().join("far.part").exists());
    assert_eq!(code(&models(home.path(), &["verify", "far"])), 0);
    let again = models(home.path(), &["fetch", "far"]);
    assert!(said(&again).contains("is here"), "{}", said(&again));
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "nothing is fetched twice"
    );
    std::fs::write(home.path().join("far.onnx"), "damaged").expect("write");
    assert_eq!(
        code(&models(home.path(), &["fetch", "far"])),
        0,
        "a damaged file is fetched anew"
    );
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
}

#[test]
fn what_an_earlier_download_left_is_used_when_it_is_whole_and_doubted_when_not() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    std::fs::write(
        home.path().join("far.part"),
        [b"of another file", &content[..40]].concat(),
    )
    .expect("write");
    let mended = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&mended), 0, "{}", said(&mended));
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "the rest, then the whole"
    );
    std::fs::remove_file(home.path().join("far.onnx")).expect("there");
    std::fs::write(home.path().join("far.part"), &content).expect("write");
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 0);
    assert_eq!(
        ranges.lock().expect("not poisoned").len(),
        2,
        "what is whole is not fetched again"
    );
}

#[test]
fn a_file_whose_checksum_nobody_knows_is_not_called_whole() {
    let home = tempfile::tempdir().expect("temporary folder");
    overlay(home.path(), "http://127.0.0.1:9/far.onnx", "", 0);
    let list = std::fs::read_to_string(home.path().join("manifest.json")).expect("written");
    let list = list.replace("\"sha256\":\"\"", "\"sha256\":null");
    std::fs::write(home.path().join("manifest.json"), list).expect("write");
    std::fs::copy(network("box3"), home.path().join("far.onnx")).expect("copy");
    let here = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&here), 0, "{}", said(&here));
    assert!(
        said(&here).contains("is not known") && !said(&here).contains("whole"),
        "{}",
        said(&here)
    );
    std::fs::write(home.path().join("far.onnx"), "cut short").expect("write");
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 4);
}

#[test]
fn what_a_network_is_known_to_return_is_compared_and_kept() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, _) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    let list = std::fs::read_to_string(home.path().join("manifest.json")).expect("written");
    let list = list.replace("\"id\":\"far\"", "\"id\":\"far\",\"golden\":\"far.golden\"");
    std::fs::write(home.path().join("manifest.json"), list).expect("write");
    let golden = home.path().join("far.golden");
    let grey = 0.5_f32.to_le_bytes().repeat(3 * 64 * 64);
    std::fs::write(&golden, &grey).expect("write");
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4, "{}", said(&refused));
    assert!(said(&refused).contains("off by"), "{}", said(&refused));
    assert_eq!(
        std::fs::read(&golden).expect("kept"),
        grey,
        "not written over by what this machine computes"
    );
    assert!(!home.path().join("far.onnx").exists());
}

#[test]
fn more_than_the_whole_is_begun_again() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    std::fs::write(
        home.path().join("far.part"),
        [&content[..], b"and more"].concat(),
    )
    .expect("write");
    let mended = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&mended), 0, "{}", said(&mended));
    assert_eq!(
        std::fs::read(home.path().join("far.onnx")).expect("fetched"),
        content
    );
    let past = format!("bytes={}-", content.len() + 8);
    assert_eq!(
        *ranges.lock().expect("not poisoned"),
        [Some(past), None],
        "refused, then the whole"
    );
}

#[test]
fn nobody_fetches_what_another_is_fetching() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, ranges) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(&content), content.len());
    let part = std::fs::File::create(home.path().join("far.part")).expect("created");
    part.lock().expect("locked");
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4, "{}", said(&refused));
    assert!(
        said(&refused).contains("being fetched already"),
        "{}",
        said(&refused)
    );
    assert!(
        ranges.lock().expect("not poisoned").is_empty(),
        "nothing was asked for"
    );
    drop(part);
    assert_eq!(code(&models(home.path(), &["fetch", "far"])), 0);
}

#[test]
fn another_file_than_the_named_one_is_thrown_away() {
    let home = tempfile::tempdir().expect("temporary folder");
    let content = std::fs::read(network("box3")).expect("golden network");
    let (url, _) = serve(content.clone(), content.len());
    overlay(home.path(), &url, &digest(b"another"), content.len());
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4);
    assert!(
        said(&refused).contains("It was removed") && said(&refused).contains(&digest(&content)),
        "{}",
        said(&refused)
    );
    assert!(!home.path().join("far.onnx").exists() && !home.path().join("far.part").exists());
}

#[test]
fn without_a_network_the_way_by_hand_is_told() {
    let home = tempfile::tempdir().expect("temporary folder");
    let closed = TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port");
    overlay(
        home.path(),
        &format!("http://{closed}/far.onnx"),
        &digest(b"x"),
        1,
    );
    let refused = models(home.path(), &["fetch", "far"]);
    assert_eq!(code(&refused), 4);
    assert!(
        said(&refused).contains("fled models add FILE --id far"),
        "{}",
        said(&refused)
    );
}
