//! Orders of jobs and their validation, through a real server process.

use std::path::Path;

use crate::support::tokens::{token, token_of};
use crate::support::{Server, photographs, text};
use fled_tests::Reply;
use serde_json::{Value, json};

/// The problem returned for an order with these options.
fn refused(server: &Server, options: &Value) -> Value {
    let order = json!({ "capture_id": server.capture(3), "options": options });
    let reply = server.post_json("/v1/jobs", &order, &[]);
    reply.expect(422).json()
}

/// A time in a response. As text, whole seconds would sort after their fractions.
fn instant(time: &Value) -> jiff::Timestamp {
    time.as_str().and_then(|time| time.parse().ok()).expect("a time")
}

#[test]
fn an_unknown_option_is_refused_with_a_pointer_to_it() {
    let server = Server::start();
    let post = |options: Value| refused(&server, &options);
    assert_eq!(post(json!({ "turbo": true }))["pointer"], "/options/turbo");
    assert_eq!(post(json!({ "rounds": 99 }))["pointer"], "/options/rounds");
    assert_eq!(
        post(json!({ "deblur_unguided": "same" }))["pointer"],
        "/options/deblur_unguided",
        "which older builds knew"
    );
}

#[test]
fn an_unknown_network_is_refused_with_the_known_ones() {
    let server = Server::start();
    let post = |options: Value| refused(&server, &options);
    let networks = post(json!({ "deblur": "/etc/hostname" }));
    assert_eq!(networks["pointer"], "/options/deblur");
    assert!(
        networks["detail"].as_str().is_some_and(|text| text.contains("identity")),
        "{networks:#}"
    );
    let enhance = post(json!({ "enhance": "identity" }));
    assert!(enhance["detail"].as_str().is_some_and(|text| text.contains("curve")), "{enhance:#}");
    let guided = post(json!({ "enhance": "default" }));
    assert!(
        guided["detail"].as_str().is_some_and(|text| text.contains("requires a guide")),
        "{guided:#}"
    );
}

#[test]
fn a_malformed_order_is_refused() {
    let server = Server::start();
    let capture = server.capture(3);
    let reply = server
        .post_json("/v1/jobs", &json!({ "capture_id": capture, "preset": "fast" }), &[])
        .expect(422);
    assert_eq!(reply.json()["pointer"], "/preset");
    let reply = server.post_json("/v1/jobs", &json!({ "capture_id": "none" }), &[]).expect(404);
    assert_eq!(reply.json()["pointer"], "/capture_id");
    server.post_json("/v1/jobs", &json!({ "capture": "x" }), &[]).expect(422);
    server.post("/v1/jobs", b"{", &[("content-type", "application/json")]).expect(400);
    server.post("/v1/jobs", b"{}", &[("content-type", "text/plain")]).expect(415);
}

#[test]
fn only_networks_of_the_models_folder_can_be_chosen() {
    let server = Server::start();
    let models = server.data.path().join("models");
    std::fs::create_dir_all(&models).expect("folder");
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/onnx");
    for name in ["mine.onnx", "notes.txt", "../outside.onnx"] {
        std::fs::copy(golden.join("identity3.onnx"), models.join(name)).expect("copied");
    }
    let capture = server.capture(3);
    for choice in ["outside.onnx", "../outside.onnx", "notes.txt", "mine"] {
        let options = json!({ "deblur": choice });
        let order = json!({ "capture_id": capture, "options": options });
        let problem = server.post_json("/v1/jobs", &order, &[]).expect(422).json();
        assert_eq!(problem["pointer"], "/options/deblur");
        assert!(
            problem["detail"]
                .as_str()
                .is_some_and(|text| text.ends_with("identity, default, small-u2w16, mine.onnx")),
            "{problem:#}"
        );
    }
    let options = json!({ "deblur": "mine.onnx", "adapter": "ok" });
    let order = json!({ "capture_id": capture, "options": options });
    server.post_json("/v1/jobs", &order, &[]).expect(202);

    // Copied without the file of its weights.
    std::fs::copy(golden.join("external3.onnx"), models.join("halves.onnx")).expect("copied");
    let problem = refused(&server, &json!({ "deblur": "halves.onnx" }));
    assert_eq!(problem["pointer"], "/options/deblur");
    let detail = problem["detail"].as_str().expect("text");
    assert!(detail.contains("`weights/external3.data`, which is not beside it"), "{detail}");
}

fn id(reply: &Reply) -> String {
    reply.json()["id"].as_str().expect("id").to_owned()
}

/// An order with this priority.
fn urgent(capture: &str, priority: &Value) -> Value {
    json!({ "capture_id": capture, "options": { "adapter": "ok" }, "priority": priority })
}

#[test]
fn queued_jobs_run_in_order_of_priority() {
    let server = Server::start_with(&[("FLED_FAKE_WORKERS", "1")]);
    let capture = server.capture(3);
    let busy = server.job("slow:300");
    server.wait_state(&busy, "running");
    let ask = |priority: i64| {
        let order = urgent(&capture, &json!(priority));
        let made = server.post_json("/v1/jobs", &order, &[]).expect(202);
        assert_eq!(made.json()["priority"], priority);
        id(&made)
    };
    let [least, none, most] = [-100, 0, 100].map(ask);
    let mut parts = photographs(3);
    parts.push(text("options", r#"{"adapter":"ok"}"#));
    parts.push(text("priority", "7"));
    let form = id(&server.upload("/v1/jobs", &parts, &[]).expect(202));
    let order = [most, form, none, least];
    let job = |id: &str| server.get(&format!("/v1/jobs/{id}"), &[]).expect(200).json();
    let places = order.each_ref().map(|id| job(id)["queue_position"].clone());
    assert_eq!(places, [1, 2, 3, 4].map(Value::from));
    server.post(&format!("/v1/jobs/{busy}/cancel"), b"", &[]).expect(202);
    let began = order.each_ref().map(|id| {
        server.wait_state(id, "succeeded");
        instant(&job(id)["started_at"])
    });
    assert!(began.is_sorted(), "{began:?}");
    // A retry keeps the priority.
    let options = json!({ "options": { "rounds": 1 } });
    let again = server.post_json(&format!("/v1/jobs/{}/retry", order[3]), &options, &[]);
    assert_eq!(again.expect(202).json()["priority"], -100);
}

#[test]
fn the_priority_of_a_queued_job_can_be_changed() {
    let server = Server::start_with(&[("FLED_FAKE_WORKERS", "1")]);
    let busy = server.job("slow:300");
    server.wait_state(&busy, "running");
    let [first, second] = ["ok", "ok"].map(|plan| server.job(plan));
    let set = |job: &str, body: Value| {
        let path = format!("/v1/jobs/{job}/priority");
        let header = ("content-type", "application/json");
        server.ask("PUT", &path, &[header], body.to_string().as_bytes())
    };
    let place = |job: &str| {
        let shown = server.get(&format!("/v1/jobs/{job}"), &[]).expect(200);
        shown.json()["queue_position"].clone()
    };
    assert_eq!((place(&first), place(&second)), (json!(1), json!(2)));
    let shown = set(&second, json!({ "priority": 3 })).expect(200).json();
    assert_eq!((&shown["priority"], &shown["queue_position"]), (&json!(3), &json!(1)));
    assert_eq!((place(&first), place(&second)), (json!(2), json!(1)));
    for bad in
        [json!({ "priority": 101 }), json!({ "priority": 0.5 }), json!({}), json!({ "urgency": 1 })]
    {
        set(&second, bad).expect(422);
    }
    set("none", json!({ "priority": 1 })).expect(404);
    // A running job keeps running.
    set(&busy, json!({ "priority": -3 })).expect(200);
    let cancel = format!("/v1/jobs/{busy}/cancel");
    server.post(&cancel, b"", &[]).expect(202);
    let began = [&second, &first].map(|job| {
        let done = server.wait_state(job, "succeeded");
        instant(&done["started_at"])
    });
    assert!(began.is_sorted(), "{began:?}");
    let refused = set(&second, json!({ "priority": 1 })).expect(409).json();
    assert_eq!(refused["code"], "wrong_state");
}

#[test]
fn an_invalid_priority_is_refused_with_a_pointer_to_it() {
    let server = Server::start();
    let capture = server.capture(3);
    for bad in [json!(101), json!(-101), json!(1.5), json!(1e30)] {
        let refused = server.post_json("/v1/jobs", &urgent(&capture, &bad), &[]).expect(422);
        assert_eq!(refused.json()["pointer"], "/priority", "{bad}");
        assert_eq!(refused.json()["code"], "bad_input", "{bad}");
    }
    server.post_json("/v1/jobs", &urgent(&capture, &json!("high")), &[]).expect(422);
    let uploads = json!({ "uploads": ["none"], "priority": 101 });
    let refused = server.post_json("/v1/jobs", &uploads, &[]).expect(422);
    assert_eq!(refused.json()["pointer"], "/priority");
    for bad in ["urgent", "1.0", "101"] {
        let mut parts = photographs(3);
        parts.push(text("priority", bad));
        let refused = server.upload("/v1/jobs", &parts, &[]).expect(422);
        assert_eq!(refused.json()["pointer"], "/priority", "{bad}");
    }
    assert_eq!(server.get("/v1/jobs", &[]).expect(200).json()["jobs"], json!([]));
}

#[test]
fn only_an_admin_sets_a_priority_above_0() {
    let server = Server::start();
    let (anna, _) = token_of("anna", &server, "jobs:read,jobs:write");
    let (admin, _) = token(&server, "admin");
    let anna = [("authorization", anna.as_str())];
    let capture = id(&server.upload("/v1/captures", &photographs(3), &anna).expect(201));
    let ask = |priority: i64, header: &[(&str, &str)]| {
        let order = urgent(&capture, &json!(priority));
        server.post_json("/v1/jobs", &order, header)
    };
    let refused = ask(1, &anna).expect(403).json();
    assert_eq!(refused["code"], "missing_scope");
    assert_eq!(refused["pointer"], "/priority");
    assert!(refused["detail"].as_str().is_some_and(|text| text.contains("admin")));
    assert!(refused["hint"].as_str().is_some_and(|text| text.contains("0 or less")));
    let mut parts = photographs(3);
    parts.push(text("priority", "1"));
    server.upload("/v1/jobs", &parts, &anna).expect(403);
    let uploads = json!({ "uploads": ["none"], "priority": 1 });
    server.post_json("/v1/jobs", &uploads, &anna).expect(403);
    ask(0, &anna).expect(202);
    ask(-100, &anna).expect(202);
    ask(100, &[("authorization", &admin)]).expect(202);
}

#[test]
fn a_different_priority_is_a_different_request() {
    let server = Server::start();
    let capture = server.capture(3);
    let key = [("idempotency-key", "one")];
    let ask = |priority: &Value| server.post_json("/v1/jobs", &urgent(&capture, priority), &key);
    let job = id(&ask(&json!(-5)).expect(202));
    assert_eq!(id(&ask(&json!(-5)).expect(202)), job, "replayed");
    assert_eq!(ask(&json!(5)).expect(422).json()["code"], "key_reused");
    assert_eq!(ask(&Value::Null).expect(422).json()["code"], "key_reused");
}

#[test]
fn without_a_worker_a_waiting_job_says_what_to_start() {
    let mut server = Server::start_with(&[("FLED_FAKE_WORKERS", "0")]);
    let job = server.job("ok");
    let lack = "This server runs no jobs. Start it again with `--workers 1` or more.";
    assert_eq!(server.show(&job)["no_worker"], lack);
    let list = server.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(list["jobs"][0]["no_worker"], lack);
    let workers = |server: &Server| {
        let ready = server.get("/readyz", &[]).json();
        let checks = ready["checks"].as_array().expect("checks").clone();
        checks.into_iter().find(|check| check["name"] == "workers").expect("a check")
    };
    let check = workers(&server);
    assert_eq!(
        (&check["ok"], &check["detail"]),
        (&false.into(), &"This server runs no jobs".into())
    );
    server.restart();
    server.wait_state(&job, "succeeded");
    assert!(server.show(&job)["no_worker"].is_null());
    assert_eq!(workers(&server)["ok"], true);
}

#[test]
fn a_job_is_found_by_its_idempotency_key() {
    let server = Server::start();
    let found = |key: &str| {
        let list = server.get(&format!("/v1/jobs?idempotency_key={key}"), &[]).expect(200).json();
        let jobs = list["jobs"].as_array().expect("jobs").clone();
        jobs.iter().map(|job| job["id"].as_str().expect("id").to_owned()).collect::<Vec<_>>()
    };
    assert!(found("a").is_empty());
    let order = json!({ "capture_id": server.capture(3), "options": { "adapter": "ok" } });
    let made = server.post_json("/v1/jobs", &order, &[("idempotency-key", "a")]).expect(202).json();
    server.post_json("/v1/jobs", &order, &[("idempotency-key", "b")]).expect(202);
    assert_eq!(found("a"), [made["id"].as_str().expect("id")]);
}

#[test]
fn a_job_without_a_preset_shows_the_detail_that_its_machine_chose() {
    let server = Server::start();
    let options = json!({ "adapter": "ok" });
    let order = json!({ "capture_id": server.capture(3), "options": options });
    let id = id(&server.post_json("/v1/jobs", &order, &[]).expect(202));
    let job = server.wait_state(&id, "succeeded");
    assert_eq!((&job["preset"], &job["options"]["detail"]), (&"auto".into(), &"auto".into()));
    let because = "a fake device is not a GPU";
    assert_eq!(job["detail"], json!({ "level": "standard", "because": because }));
    // Its options stay open for the machine of another attempt.
    let preview = server.wait_state(&server.job("ok"), "succeeded");
    assert_eq!(preview["detail"], Value::Null, "its preset names the detail");
}
