//! The API through a real server process: uploads, results, renders, refusals.

mod support;

use serde_json::json;
use support::{Server, file, photograph, photographs, text, zip};

#[test]
fn bad_files_are_listed_and_the_rest_goes_on_until_too_few_remain() {
    let server = Server::start();
    let mut parts = photographs(3);
    parts.push(file("broken.jpg", b"this is text"));
    let reply = server
        .upload("/v1/captures", &parts, &[])
        .expect(201)
        .json();
    assert_eq!(reply["accepted"], 3);
    let images = reply["images"].as_array().expect("assessments");
    let broken = images
        .iter()
        .find(|image| image["name"] == "broken.jpg")
        .expect("listed");
    assert!(
        broken["accepted"] == false && broken["reason"].is_string(),
        "{broken}"
    );
    let reply = server.upload("/v1/captures", &parts[2..], &[]).expect(422);
    assert_eq!(reply.header("content-type"), "application/problem+json");
    let problem = reply.json();
    assert_eq!(problem["code"], "bad_input");
    assert!(
        problem["hint"].is_string()
            && problem["capture"]["images"]
                .as_array()
                .is_some_and(|v| v.len() == 2)
    );
    server
        .upload("/v1/captures", &[text("name", "nothing")], &[])
        .expect(422);
    let dry = server
        .upload("/v1/captures?dry_run", &photographs(3), &[])
        .expect(200)
        .json();
    assert!(dry["id"].is_null() && dry["accepted"] == 3);
    let list = server.get("/v1/captures", &[]).expect(200).json();
    assert_eq!(
        list["captures"].as_array().map(Vec::len),
        Some(1),
        "only what was accepted is kept"
    );
    let left = std::fs::read_dir(server.data.path().join("data/incoming"))
        .expect("folder")
        .count();
    assert_eq!(left, 0, "refused uploads leave files");
}

#[test]
fn a_zip_is_judged_by_its_own_names_and_kept_as_it_is() {
    let server = Server::start();
    let names = [
        "walk/images/a.png",
        "walk/images/b.png",
        "walk/images/c.png",
        "walk/gt/a.png",
    ];
    let content: Vec<(&str, Vec<u8>)> = (0..)
        .zip(names)
        .map(|(i, name)| (name, photograph(i)))
        .collect();
    let reply = server
        .upload("/v1/captures", &[file("walk.zip", &zip(&content))], &[])
        .expect(201)
        .json();
    assert_eq!(
        reply["accepted"], 3,
        "ground truth is no photograph: {reply:#}"
    );
    assert_eq!(reply["images"][0]["name"], "a.png");
    let capture = server
        .data
        .path()
        .join("data/captures")
        .join(reply["id"].as_str().expect("id"));
    let kept: Vec<_> = std::fs::read_dir(capture)
        .expect("folder")
        .flatten()
        .map(|e| e.file_name())
        .collect();
    assert_eq!(kept, ["upload.zip"]);
    let bad = server
        .upload("/v1/captures", &[file("a.zip", b"no zip at all")], &[])
        .expect(422)
        .json();
    assert!(
        !bad["detail"].as_str().expect("detail").contains("incoming"),
        "a path of the server is told: {bad}"
    );
    let parts = [
        file("walk.zip", &zip(&content)),
        file("a.png", &photograph(1)),
    ];
    server.upload("/v1/captures", &parts, &[]).expect(422);
}

#[test]
fn names_cannot_lead_out_of_the_capture() {
    let server = Server::start();
    let names = [
        "../../../evil.png",
        "/etc/evil.png",
        "a\\..\\..\\evil.png",
        "-rf.png",
        "日本.png",
    ];
    let parts: Vec<_> = names
        .iter()
        .enumerate()
        .map(|(i, name)| file(name, &photograph(i)))
        .collect();
    let reply = server
        .upload("/v1/captures", &parts, &[])
        .expect(201)
        .json();
    assert_eq!(reply["accepted"], 5, "{reply:#}");
    let capture = server
        .data
        .path()
        .join("data/captures")
        .join(reply["id"].as_str().expect("id"));
    assert_eq!(
        std::fs::read_dir(capture.join("images"))
            .expect("images")
            .count(),
        5
    );
    assert!(
        !server.data.path().join("evil.png").exists()
            && !server.data.path().join("data/evil.png").exists()
    );
}

#[test]
fn an_unknown_option_is_refused_with_a_pointer_to_it() {
    let server = Server::start();
    let capture = server.capture(3);
    let post = |options: serde_json::Value| {
        server
            .post_json(
                "/v1/jobs",
                &json!({ "capture_id": capture, "options": options }),
                &[],
            )
            .expect(422)
            .json()
    };
    assert_eq!(post(json!({ "turbo": true }))["pointer"], "/options/turbo");
    assert_eq!(post(json!({ "rounds": 99 }))["pointer"], "/options/rounds");
    let networks = post(json!({ "deblur": "/etc/hostname" }));
    assert_eq!(networks["pointer"], "/options/deblur");
    assert!(
        networks["detail"]
            .as_str()
            .is_some_and(|text| text.contains("identity")),
        "{networks:#}"
    );
    let networks = post(json!({ "deblur": "nafnet-gopro-w32" }));
    assert!(
        networks["hint"]
            .as_str()
            .is_some_and(|hint| hint.contains("fled models fetch nafnet-gopro-w32")),
        "known, but its file is not here: {networks:#}"
    );
    assert_eq!(
        post(json!({ "deblur_unguided": "a.onnx" }))["pointer"],
        "/options/deblur_unguided"
    );
    let enhance = post(json!({ "enhance": "identity" }));
    assert!(
        enhance["detail"]
            .as_str()
            .is_some_and(|text| text.contains("curve")),
        "{enhance:#}"
    );
    let guided = post(json!({ "enhance": "default" }));
    assert!(
        guided["detail"]
            .as_str()
            .is_some_and(|text| text.contains("wants a guide")),
        "{guided:#}"
    );
    let reply = server
        .post_json(
            "/v1/jobs",
            &json!({ "capture_id": capture, "preset": "fast" }),
            &[],
        )
        .expect(422);
    assert_eq!(reply.json()["pointer"], "/preset");
    let reply = server
        .post_json("/v1/jobs", &json!({ "capture_id": "none" }), &[])
        .expect(404);
    assert_eq!(reply.json()["pointer"], "/capture_id");
    server
        .post_json("/v1/jobs", &json!({ "capture": "x" }), &[])
        .expect(422);
    server
        .post("/v1/jobs", b"{", &[("content-type", "application/json")])
        .expect(400);
    server
        .post("/v1/jobs", b"{}", &[("content-type", "text/plain")])
        .expect(415);
}

#[test]
fn a_damaged_network_is_told_before_the_job() {
    let server = Server::start();
    let capture = server.capture(3);
    let entry = json!({
        "id": "mine", "role": "single", "file": "mine.onnx", "url": null, "sha256": "0".repeat(64), "bytes": 7, "licence": "MIT",
        "channels": 3, "order": ["blurry"], "multiple": 16, "minimum_side": 16, "tile": 1024, "range": [-1.0, 2.0],
        "input": null, "output": null, "default": false, "verified": true,
    });
    let models = server.data.path().join("models");
    std::fs::create_dir_all(&models).expect("folder");
    std::fs::write(
        models.join("manifest.json"),
        json!({ "models": [entry] }).to_string(),
    )
    .expect("written");
    std::fs::write(models.join("mine.onnx"), "content").expect("written");
    let job = json!({ "capture_id": capture, "options": { "deblur": "mine" } });
    let refused = server.post_json("/v1/jobs", &job, &[]).expect(422).json();
    assert_eq!(refused["pointer"], "/options/deblur");
    assert!(
        refused["detail"]
            .as_str()
            .is_some_and(|text| text.contains("damaged")),
        "{refused:#}"
    );
    assert!(
        !refused.to_string().contains("manifest.json"),
        "no paths of the server: {refused:#}"
    );
}

#[test]
fn another_sites_page_cannot_start_jobs() {
    let server = Server::start();
    let evil = [
        ("origin", "https://evil.example"),
        ("sec-fetch-site", "cross-site"),
    ];
    // A small body: the refusal comes before it is read.
    server
        .upload("/v1/jobs", &[text("name", "evil")], &evil)
        .expect(403);
    let own = [("origin", server.base.as_str())];
    server
        .upload("/v1/captures", &photographs(3), &own)
        .expect(201);
}

#[test]
fn results_come_whole_in_ranges_and_not_at_all_when_known() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let list = server
        .get(&format!("/v1/jobs/{job}/artifacts"), &[])
        .expect(200)
        .json();
    let artifacts = list["artifacts"].as_array().expect("list");
    let names: Vec<&str> = artifacts
        .iter()
        .filter_map(|a| a["name"].as_str())
        .collect();
    for name in [
        "scene.ply",
        "cameras.json",
        "metrics.json",
        "rounds/1/renders/000.jpg",
        "inputs/003.jpg",
    ] {
        assert!(names.contains(&name), "{name} is missing in {names:?}");
    }
    assert!(
        !names.iter().any(|name| name.starts_with('.')),
        "private files are listed"
    );
    let path = format!("/v1/jobs/{job}/artifacts/scene.ply");
    let whole = server.get(&path, &[]).expect(200);
    assert_eq!(whole.text(), "ply of round 2");
    // printf 'ply of round 2' | sha256sum
    let scene = artifacts
        .iter()
        .find(|a| a["name"] == "scene.ply")
        .expect("listed");
    assert_eq!(
        whole.header("etag"),
        format!("\"{}\"", scene["sha256"].as_str().expect("digest"))
    );
    let part = server.get(&path, &[("range", "bytes=4-5")]).expect(206);
    assert_eq!(
        (part.text().as_str(), part.header("content-range")),
        ("of", "bytes 4-5/14")
    );
    server.get(&path, &[("range", "bytes=99-")]).expect(416);
    server
        .get(&path, &[("if-none-match", whole.header("etag"))])
        .expect(304);
    for name in [
        "..%2f..%2ffled.db",
        "../../fled.db",
        ".done-poses-0",
        "none",
        "rounds",
    ] {
        let status = server
            .get(&format!("/v1/jobs/{job}/artifacts/{name}"), &[])
            .status;
        assert_eq!(status, 404, "{name}");
    }
}

#[test]
fn renders_come_while_the_job_trains_from_the_last_finished_round() {
    let server = Server::start();
    let job = server.job("slow:40");
    server.wait(&job, "running", |shown| shown["state"] == "running");
    let render = |query: &str| server.get(&format!("/v1/jobs/{job}/render?{query}"), &[]);
    assert_eq!(
        render("azimuth=10").expect(409).json()["code"],
        "no_scene_yet"
    );
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
    assert_ne!(
        render("azimuth=20&elevation=5&width=64")
            .expect(200)
            .header("etag"),
        tag
    );
    let png = render("view=001&format=png&round=1").expect(200);
    assert_eq!(&png.body[1..4], b"PNG");
    assert_eq!(
        (png.body[19], png.body[23]),
        (160, 90),
        "the view's own size"
    );
    render("view=nobody").expect(404);
    render("round=2").expect(404);
    render("width=99999").expect(422);
    render("azimuth=NaN").expect(422);
    render("azimut=1").expect(400);
    server.wait_state(&job, "succeeded");
    assert_ne!(
        render("azimuth=10&elevation=5&width=64")
            .expect(200)
            .header("etag"),
        tag,
        "the delivered scene is another"
    );
    let camera = json!({ "world_to_camera": [[1.0,0.0,0.0,0.0],[0.0,1.0,0.0,0.0],[0.0,0.0,1.0,4.0],[0.0,0.0,0.0,1.0]],
        "intrinsics": { "width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 32.0, "cy": 24.0 }, "format": "png" });
    server
        .post_json(&format!("/v1/jobs/{job}/render"), &camera, &[])
        .expect(200);
    let mut skewed = camera.clone();
    skewed["world_to_camera"][0][0] = json!(2.0);
    assert_eq!(
        server
            .post_json(&format!("/v1/jobs/{job}/render"), &skewed, &[])
            .expect(422)
            .json()["code"],
        "bad_camera"
    );
}

#[test]
fn a_render_process_that_dies_costs_one_picture_and_not_the_service() {
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

#[test]
fn lists_are_paged_without_gap_and_filtered_by_state() {
    let server = Server::start();
    let mut jobs: Vec<String> = (0..3).map(|_| server.job("ok")).collect();
    let failed = server.job("few_poses");
    jobs.push(failed.clone());
    jobs.reverse();
    server.wait_state(&failed, "failed");
    let (mut seen, mut cursor) = (Vec::new(), String::new());
    loop {
        let page = server
            .get(&format!("/v1/jobs?limit=2{cursor}"), &[])
            .expect(200)
            .json();
        seen.extend(
            page["jobs"]
                .as_array()
                .expect("jobs")
                .iter()
                .filter_map(|job| job["id"].as_str().map(str::to_owned)),
        );
        match page["next_cursor"].as_str() {
            Some(next) => cursor = format!("&cursor={next}"),
            None => break,
        }
    }
    assert_eq!(seen, jobs);
    let page = server.get("/v1/jobs?state=failed", &[]).expect(200).json();
    assert_eq!(page["jobs"].as_array().map(Vec::len), Some(1));
    server.get("/v1/jobs?state=done", &[]).expect(400);
}

#[test]
fn health_says_what_is_missing_and_what_to_do() {
    let server = Server::start();
    assert_eq!(server.get("/livez", &[]).expect(200).text(), "ok\n");
    let ready = server.get("/readyz", &[]).expect(503).json();
    let checks = ready["checks"].as_array().expect("checks");
    let check = |name: &str| {
        checks
            .iter()
            .find(|check| check["name"] == name)
            .expect("checked")
    };
    assert_eq!(
        (
            &check("database")["ok"],
            &check("disk")["ok"],
            &check("adapter")["ok"]
        ),
        (&true.into(), &true.into(), &true.into())
    );
    assert_eq!(check("colmap")["hint"], "apt-get install colmap");
    let page = server.get("/", &[]).expect(200);
    assert!(
        page.header("content-security-policy")
            .contains("default-src 'none'")
    );
    assert!(page.text().contains("<title>fled</title>"));
    let missing = server.get("/nowhere", &[]).expect(404);
    assert_eq!(missing.header("content-type"), "application/problem+json");
    assert!(
        server
            .get("/openapi.yaml", &[])
            .expect(200)
            .text()
            .starts_with("openapi: 3.1")
    );
}
