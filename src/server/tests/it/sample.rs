//! The sample that the server ships, through real server processes.

use std::fs;

use fled_server::store::Quotas;
use fled_tests::Client;
use serde_json::{Value, json};

use crate::support::Server;
use crate::support::farm::{Farm, scene};
use crate::support::tokens::token_with;

const USER: &str = "jobs:read,jobs:write,renders";

/// Creates a sample and returns its capture and job.
fn create(api: &Client, headers: &[(&str, &str)]) -> (Value, Value) {
    let reply = api.post("/v1/captures/sample", b"", headers).expect(201);
    let capture = reply.json();
    let id = capture["id"].as_str().expect("id");
    assert_eq!(reply.location(), format!("/v1/captures/{id}"));
    let jobs = api.get(&format!("/v1/jobs?capture_id={id}"), headers).expect(200).json();
    let [job] = jobs["jobs"].as_array().expect("jobs").as_slice() else {
        panic!("one job: {jobs}");
    };
    (capture, job.clone())
}

#[test]
fn a_sample_has_a_finished_job_and_starts_others() {
    let server = Server::start();
    let (capture, job) = create(&server, &[]);
    let id = job["id"].as_str().expect("id");
    assert_eq!((&capture["accepted"], &capture["warnings"]), (&16.into(), &json!([])));
    assert_eq!((&job["state"], &job["preset"]), (&"succeeded".into(), &"auto".into()));
    // It says that it did not run here.
    assert_eq!((&job["attempts"], &job["started_at"]), (&0.into(), &Value::Null));
    assert_eq!(job["warnings"][0]["code"], "recorded");
    assert!(job["score"]["psnr_cc_db"].as_f64().is_some_and(|psnr| psnr > 20.0), "{job}");

    let rounds = server.get(&format!("/v1/jobs/{id}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().map(Vec::len), Some(2));
    let events = server.events(id, 0, usize::MAX);
    let states: Vec<_> = events.iter().filter(|(_, kind, _)| kind == "state").collect();
    assert_eq!(states.last().map(|(.., data)| &data["state"]), Some(&"succeeded".into()));
    let artifacts = server.get(&format!("/v1/jobs/{id}/artifacts"), &[]).expect(200).json();
    let named = |name: &str| {
        let all = artifacts["artifacts"].as_array().expect("artifacts");
        all.iter().find(|file| file["name"] == name).cloned()
    };
    let delivered = named("scene.ply").expect("a scene");
    assert_eq!(named("rounds/2/scene.ply").expect("its round's")["sha256"], delivered["sha256"]);
    for name in ["restored/015.png", "inputs/000.jpg", "gt/007.jpg", "rounds/1/renders/003.jpg"] {
        assert!(named(name).is_some_and(|file| file["bytes"].as_u64() > Some(1000)), "{name}");
    }
    let log = server.get(&format!("/v1/jobs/{id}/log"), &[]).expect(200).text();
    assert!(log.contains("round 2 is delivered"), "{log}");

    let body = json!({ "capture_id": capture["id"], "options": { "adapter": "ok" } });
    let own = server.post_json("/v1/jobs", &body, &[]).expect(202).json();
    let own = server.wait_state(own["id"].as_str().expect("id"), "succeeded");
    assert_eq!(own["attempts"], 1);

    // Run with other options, it is no recording any more.
    let other = json!({ "options": { "adapter": "ok" } });
    server.post_json(&format!("/v1/jobs/{id}/retry"), &other, &[]).expect(202);
    let again = server.wait_state(id, "succeeded");
    let warnings = again["warnings"].as_array().expect("warnings");
    assert!(warnings.iter().all(|warning| warning["code"] != "recorded"), "{again}");
}

#[test]
fn a_sample_beyond_the_quota_leaves_nothing() {
    let server = Server::start();
    // The photographs fit, and the result does not.
    let quotas = Quotas { bytes: Some(2_000_000), ..Quotas::default() };
    let (anna, _) = token_with(&server, "anna", USER, quotas);
    let headers = [("authorization", anna.as_str())];
    let refused = server.post("/v1/captures/sample", b"", &headers).expect(507);
    assert_eq!(refused.json()["code"], "quota_bytes");
    let listed = server.get("/v1/jobs", &headers).expect(200).json();
    assert_eq!(listed["jobs"], json!([]));
    for folder in ["captures", "jobs", "incoming"] {
        let path = server.data.path().join("data").join(folder);
        let left: Vec<_> = fs::read_dir(&path).expect("a folder").collect();
        assert!(left.is_empty(), "{folder}: {left:?}");
    }
    let (ben, _) = token_with(&server, "ben", USER, Quotas::default());
    create(&server, &[("authorization", ben.as_str())]);
}

#[test]
fn a_sample_made_at_one_replica_is_whole_at_another() {
    let farm = Farm::new();
    let (mut one, at_one) = farm.replica("one");
    let (_two, at_two) = farm.replica("two");
    let (capture, job) = create(&at_one, &[]);
    one.kill();
    let id = job["id"].as_str().expect("id");
    assert!(scene(&at_two, id).starts_with(b"ply\n"));
    let id = capture["id"].as_str().expect("id");
    at_two.get(&format!("/v1/captures/{id}/photographs/000.jpg"), &[]).expect(200);
}
