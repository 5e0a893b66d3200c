//! Files and renders of a job through a real server process.

use crate::support::Server;
use serde_json::json;

#[test]
fn results_are_sent_whole_in_ranges_or_as_not_modified() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let list = server.get(&format!("/v1/jobs/{job}/artifacts"), &[]).expect(200).json();
    let artifacts = list["artifacts"].as_array().expect("list");
    let names: Vec<&str> = artifacts.iter().filter_map(|a| a["name"].as_str()).collect();
    for name in
        ["scene.ply", "cameras.json", "metrics.json", "rounds/1/renders/000.jpg", "inputs/003.jpg"]
    {
        assert!(names.contains(&name), "{name} is missing in {names:?}");
    }
    assert!(!names.iter().any(|name| name.starts_with('.')), "private files are listed");
    let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
    let whole = server.get(&path, &[]).expect(200);
    assert_eq!(whole.text(), "ply of round 2");
    // printf 'ply of round 2' | sha256sum
    let scene = artifacts.iter().find(|a| a["name"] == "scene.ply").expect("listed");
    assert_eq!(whole.header("etag"), format!("\"{}\"", scene["sha256"].as_str().expect("digest")));
    let part = server.get(&path, &[("range", "bytes=4-5")]).expect(206);
    assert_eq!((part.text().as_str(), part.header("content-range")), ("of", "bytes 4-5/14"));
    server.get(&path, &[("range", "bytes=99-")]).expect(416);
    server.get(&path, &[("if-none-match", whole.header("etag"))]).expect(304);
    for name in ["..%2f..%2ffled.db", "../../fled.db", ".done-poses-0", "none", "rounds"] {
        let status = server.get(&format!("/v1/jobs/{job}/artifacts/{name}"), &[]).status;
        assert_eq!(status, 404, "{name}");
    }
}

#[test]
fn renders_of_a_running_job_show_its_last_finished_round() {
    let server = Server::start();
    let job = server.job("slow:40");
    server.wait(&job, "running", |shown| shown["state"] == "running");
    let render = |query: &str| server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]);
    assert_eq!(render("azimuth=10").expect(409).json()["code"], "no_scene_yet");
    server.wait(&job, "in round 2", |shown| shown["round"] == 2);
    let picture = render("azimuth=10&elevation=5&width=64").expect(200);
    assert_eq!(
        (picture.header("content-type"), &picture.body[..2]),
        ("image/jpeg", &[0xff, 0xd8][..])
    );
    let tag = picture.header("etag").to_owned();
    server
        .get(
            &format!("/v1/jobs/{job}/render?azimuth=10&elevation=5&width=64"),
            &[("if-none-match", &tag)],
        )
        .expect(304);
    assert_ne!(render("azimuth=20&elevation=5&width=64").expect(200).header("etag"), tag);
    let png = render("view=001&format=png&round=1").expect(200);
    assert_eq!(&png.body[1..4], b"PNG");
    assert_eq!((png.body[19], png.body[23]), (160, 90), "the view's own size");
    let depth = render("view=001&format=png&round=1&show=depth").expect(200);
    assert_ne!(depth.header("etag"), png.header("etag"));
    assert_ne!(depth.body, png.body);
    let part = render("view=001&format=png&round=1&crop=sphere:0,0,0,1").expect(200);
    assert_ne!(part.header("etag"), png.header("etag"));
    assert_ne!(part.body, png.body);
    for (crop, fault) in [("sphere:0,0,0", "must be box"), ("sphere:9,0,0,1", "is inside")] {
        let refused = render(&format!("view=001&crop={crop}")).expect(422).json();
        assert_eq!(refused["pointer"], "/crop");
        assert!(refused["detail"].as_str().is_some_and(|why| why.contains(fault)), "{refused:#}");
    }
    render("view=001&show=height").expect(422);
    render("view=no-such-view").expect(404);
    render("round=2").expect(404);
    render("width=99999").expect(422);
    render("azimuth=NaN").expect(422);
    render("azimut=1").expect(422);
    server.wait_state(&job, "succeeded");
    assert_ne!(
        render("azimuth=10&elevation=5&width=64").expect(200).header("etag"),
        tag,
        "the delivered scene is another"
    );
}

#[test]
fn a_training_reports_scores_and_a_preview_that_ends_with_it() {
    let server = Server::start();
    let job = server.job("reconstruct:700");
    let live = |tag: &str| {
        let path = format!("/v1/jobs/{job}/live");
        server.get(&path, &[("if-none-match", tag)])
    };
    server.wait(&job, "seen", |_| live("").status == 200);
    let first = live("").expect(200);
    server.wait(&job, "seen twice", |_| live(first.header("etag")).status == 200);
    // The picture may change between the two requests.
    server.wait(&job, "seen unchanged", |_| {
        let picture = live("").expect(200);
        assert_eq!(
            (picture.header("content-type"), &picture.body[..2]),
            ("image/jpeg", &[0xff, 0xd8][..])
        );
        assert_eq!(picture.header("cache-control"), "no-cache");
        live(picture.header("etag")).status == 304
    });
    let list = server.get(&format!("/v1/jobs/{job}/artifacts"), &[]);
    assert!(!list.text().contains("training.jpg"), "it is no result");
    server.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]).expect(202);
    server.wait_state(&job, "cancelled");
    live("").expect(204);
    let left = format!("data/jobs/{job}/output/work/training.jpg");
    assert!(!server.data.path().join(left).exists());

    let events = server.events(&job, 0, usize::MAX);
    let data_of = |name: &str| -> Vec<_> {
        let of_name = events.iter().filter(|(_, kind, _)| kind == name);
        of_name.map(|(_, _, data)| data.clone()).collect()
    };
    let (scores, views) = (data_of("held_out_seen"), data_of("view_seen"));
    // The cancellation may come between the second picture and the events that report it.
    assert!(!views.is_empty() && !scores.is_empty(), "{events:?}");
    assert_eq!(
        scores[0],
        json!({ "event": "held_out_seen", "round": 1, "step": 100, "steps": 1000,
            "psnr_cc_db": 20.0, "ssim": 0.65, "views": 3, "truth": false })
    );
    assert_eq!(
        views[0],
        json!({ "event": "view_seen", "round": 1, "step": 100, "view": "000", "held_out": true })
    );
    let log = server.get(&format!("/v1/jobs/{job}/log"), &[]).expect(200);
    assert!(!log.text().contains("Seen"), "{}", log.text());
}

#[test]
fn a_custom_camera_must_be_rigid() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let camera = json!({ "world_to_camera": [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],[0.0,0.0,1.0,4.0],[0.0,0.0,0.0,1.0]],
        "intrinsics": { "width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0 }, "format": "png" });
    server.post_json(&format!("/v1/jobs/{job}/render"), &camera, &[]).expect(200);
    let mut skewed = camera.clone();
    skewed["world_to_camera"][0][0] = json!(2.0);
    assert_eq!(
        server.post_json(&format!("/v1/jobs/{job}/render"), &skewed, &[]).expect(422).json()["code"],
        "bad_camera"
    );
}

#[test]
fn a_crash_of_the_renderer_fails_only_one_render() {
    let server = Server::start();
    let (good, bad) = (server.job("ok"), server.job("bad_scene"));
    server.wait_state(&good, "succeeded");
    server.wait_state(&bad, "succeeded");
    let render =
        |job: &str, query: &str| server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]);
    render(&good, "azimuth=1").expect(200);
    let problem = render(&bad, "round=1").expect(503).json();
    assert_eq!(problem["code"], "render_failed");
    render(&good, "azimuth=2").expect(200);
}
