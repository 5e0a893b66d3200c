//! Exports through a real server process.

use std::fs;
use std::io::Cursor;

use crate::support::Server;
use crate::support::tokens::token_of;
use fled_tests::Reply;
use serde_json::json;
use zip::ZipArchive;

const FORMS: [&str; 14] = [
    "restored.zip",
    "linear.zip",
    "colmap.zip",
    "transforms.json",
    "cameras.inria.json",
    "scene.ply",
    "scene.compressed.ply",
    "scene.glb",
    "scene.usda",
    "scene.v3.spz",
    "scene.spz",
    "scene.sog",
    "mesh.ply",
    "mesh.glb",
];

fn names(reply: &Reply) -> Vec<String> {
    let archive = ZipArchive::new(Cursor::new(&reply.body)).expect("a zip");
    let mut names: Vec<String> =
        archive.file_names().map(|name| name.expect("a name").into_owned()).collect();
    names.sort();
    names
}

#[test]
fn every_listed_export_of_a_finished_job_can_be_downloaded() {
    let server = Server::start();
    let job = server.job("splats");
    server.wait_state(&job, "succeeded");
    let get = |path: &str| server.get(&format!("/v1/jobs/{job}/exports{path}"), &[]);
    let list = get("").expect(200).json();
    let exports = list["exports"].as_array().expect("a list");
    let listed: Vec<&str> = exports.iter().filter_map(|e| e["name"].as_str()).collect();
    assert_eq!(listed, FORMS);
    for export in exports {
        let name = export["name"].as_str().expect("a name");
        let can_be_cropped = name.starts_with("scene") || name.starts_with("mesh");
        assert_eq!(export["has_scene"], can_be_cropped, "{name}");
        let reply = get(&format!("/{name}")).expect(200);
        let said = export["bytes"].as_u64().expect("a number");
        let sent = reply.body.len() as u64;
        // Equal balls compress better than any scene, and drawn pictures than any render.
        let is_compressed = ["spz", "sog", ".zip"].iter().any(|end| name.ends_with(end));
        // The size of a mesh is that of the largest.
        let may_be_small = is_compressed || name.starts_with("mesh");
        assert!(sent < 2 * said && (may_be_small || said / 2 < sent), "{name}: {said}, {sent}");
        let disposition = reply.header("content-disposition").to_owned();
        assert_eq!(disposition, format!("attachment; filename=\"{name}\""));
    }
    let restored = names(&get("/restored.zip"));
    assert_eq!(restored, ["000.png", "001.png", "002.png", "003.png"]);
    let of_round = names(&get("/restored.zip?round=1").expect(200));
    assert_eq!(of_round, ["000.jpg", "001.jpg", "002.jpg", "003.jpg"]);
    let colmap = names(&get("/colmap.zip"));
    for name in ["images/003.png", "sparse/0/cameras.txt", "sparse/0/images.txt"] {
        assert!(colmap.iter().any(|one| one == name), "{name} in {colmap:?}");
    }
    let scene = get("/scene.compressed.ply");
    assert!(scene.body.starts_with(b"ply\nformat binary_little_endian 1.0\nelement chunk 4\n"));
    get("/scene.obj").expect(404);
    get("/restored.zip?round=9").expect(404);
    get("/restored.zip?rounds=1").expect(422);
}

#[test]
fn a_downloaded_scene_is_cropped_and_has_the_wanted_harmonics() {
    let server = Server::start();
    let job = server.job("splats");
    server.wait_state(&job, "succeeded");
    let get = |query: &str| server.get(&format!("/v1/jobs/{job}/exports/scene.ply{query}"), &[]);
    let body = |query: &str| get(query).expect(200).body.len();
    let whole = body("");
    assert!(body("?crop=box:0,0,0,1,1,1") < whole / 2);
    assert!(body("?crop=sphere:0,0,0,1000&sh_degree=3") > 3 * whole);
    let first = |query: &str| {
        let body = get(query).expect(200).body;
        let end = b"end_header\n";
        let at = body.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
        f32::from_le_bytes(body[at..][..4].try_into().expect("four"))
    };
    assert!((first("?scale=2.5") - 2.5 * first("")).abs() < 1e-5 && first("") != 0.0);
    for (query, pointer, fault) in [
        ("scale=0", "/scale", "`scale` must be from 0.000001 to 1000000, not 0"),
        ("scale=inf", "/scale", "`scale` must be a number"),
        ("scale=x", "/scale", "`scale` must be a number"),
        ("crop=box:0,0,0,1,1", "/crop", "must be box:X,Y,Z"),
        ("crop=sphere:0,0,0,-1", "/crop", "must be positive"),
        ("crop=sphere:0,0,x,1", "/crop", "`x` is not a number"),
        ("sh_degree=4", "/sh_degree", "must be from 0 to 3"),
        ("sh_degree=-1", "/sh_degree", ""),
    ] {
        let problem = get(&format!("?{query}")).expect(422).json();
        assert_eq!(problem["pointer"], pointer, "{problem}");
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(detail.contains(fault), "{detail}");
    }
    let problem = get("?crop=sphere:900,0,0,1").expect(422).json();
    let detail = problem["detail"].as_str().expect("a detail");
    assert!(detail.contains("no Gaussian's centre is inside the crop"), "{detail}");
    // A format's limits are checked only while it is written.
    let spz = server.get(&format!("/v1/jobs/{job}/exports/scene.spz?scale=1e6"), &[]);
    let problem = spz.expect(422).json();
    let detail = problem["detail"].as_str().expect("a detail");
    assert!(detail.starts_with("SPZ holds"), "{detail}");
    let zip = server.get(&format!("/v1/jobs/{job}/exports/restored.zip?sh_degree=1"), &[]);
    assert_eq!(zip.expect(422).json()["code"], "bad_input");
}

#[test]
fn a_mesh_is_made_by_a_process_with_limits() {
    let make = |server: &Server, query: &str| {
        let job = server.job("splats");
        server.wait_state(&job, "succeeded");
        server.get(&format!("/v1/jobs/{job}/exports/mesh.ply{query}"), &[])
    };
    let server = Server::start();
    let query = "?crop=sphere:0,0,0,1000&scale=2.5&triangles=5000&voxel=0.25";
    let made = make(&server, query).expect(200);
    assert_eq!(made.header("content-disposition"), "attachment; filename=\"mesh.ply\"");
    let words = made.text();
    let words: Vec<&str> = words.lines().skip(1).collect();
    let memory = format!("{}", 3_u64 << 30);
    let [crop, scale] = ["--crop=sphere:0,0,0,1000", "--scale=2.5"];
    let expected = ["mesh.ply", crop, scale, "--triangles=5000", "--voxel=0.25", "--memory"];
    assert_eq!(words, [&expected[..], &[&memory]].concat());
    for (query, pointer) in [("triangles=3", "/triangles"), ("voxel=-1", "/voxel")] {
        let refused = make(&server, &format!("?{query}")).expect(422).json();
        assert_eq!(refused["pointer"], pointer, "{refused}");
    }
    let refused = make(&server, "?sh_degree=1").expect(422).json();
    assert!(refused["detail"].as_str().is_some_and(|text| text.contains("harmonics")));
    for (plan, status, words) in [
        ("empty", 409, "no surface is seen"),
        ("fine", 422, "its voxels are too fine"),
        ("large", 422, "3072 MiB of memory"),
        ("slow", 422, "more than 1 s"),
        ("broken", 500, "The server failed"),
    ] {
        let plan = [("FLED_FAKE_MESH", plan), ("FLED_FAKE_MESHING_MS", "1000")];
        let server = Server::start_with(&plan);
        let problem = make(&server, "").expect(status).json();
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(detail.contains(words), "{detail}");
        assert_eq!(problem["code"] == "too_large", problem["hint"].is_string(), "{problem}");
        let incoming = server.data.path().join("data/incoming");
        assert_eq!(fs::read_dir(incoming).expect("a folder").count(), 0);
    }
}

#[test]
fn a_running_job_exports_only_its_finished_rounds() {
    let server = Server::start();
    let job = server.job("slow:40");
    server.wait(&job, "running", |shown| shown["state"] == "running");
    let get = |path: &str| server.get(&format!("/v1/jobs/{job}/exports{path}"), &[]);
    for path in ["", "/restored.zip"] {
        let problem = get(path).expect(409).json();
        assert_eq!(problem["code"], "not_finished");
        let detail = problem["detail"].as_str().expect("a detail");
        assert!(detail.contains("running"), "{detail}");
    }
    server.wait(&job, "in round 2", |shown| shown["round"] == 2);
    assert_eq!(names(&get("/restored.zip?round=1").expect(200)).len(), 4);
    get("/restored.zip?round=2").expect(404);
}

#[test]
fn an_impossible_export_is_refused_before_it_is_sent() {
    let server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    let path = format!("/v1/jobs/{job}/exports");
    let list = server.get(&path, &[]).expect(200).json();
    let exports = list["exports"].as_array().expect("a list");
    assert_eq!(exports.len(), 2, "its scene is none: {exports:?}");
    let scene = server.get(&format!("{path}/scene.compressed.ply"), &[]);
    let problem = scene.expect(409).json();
    assert_eq!(problem["code"], "no_export");
    let text = problem.to_string();
    let data = server.data.path().display().to_string();
    assert!(!text.contains(&data), "{text}");
}

#[test]
fn a_share_link_shows_exports_and_a_stranger_sees_none() {
    let server = Server::start();
    let job = server.job("splats");
    server.wait_state(&job, "succeeded");
    let (admin, _) = token_of("root", &server, "admin");
    let shares = format!("/v1/jobs/{job}/shares");
    let made = server.post_json(&shares, &json!({}), &[("authorization", &admin)]);
    let made = made.expect(201).json();
    let link = format!("Bearer {}", made["token"].as_str().expect("a token"));
    let (stranger, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let get = |path: &str, who: &str| {
        let path = format!("/v1/jobs/{job}/exports{path}");
        server.get(&path, &[("authorization", who)]).status
    };
    for path in ["", "/restored.zip", "/scene.compressed.ply"] {
        assert_eq!(get(path, &link), 200, "{path}");
        assert_eq!(get(path, &stranger), 404, "{path}");
        let anonymous = server.get(&format!("/v1/jobs/{job}/exports{path}"), &[]);
        anonymous.expect(401);
    }
}
