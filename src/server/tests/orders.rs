//! What is asked of a job, and when it is refused, through a real server process.

mod support;

use serde_json::json;
use support::Server;

/// The problem with an order of these options.
fn refused(server: &Server, options: &serde_json::Value) -> serde_json::Value {
    let order = json!({ "capture_id": server.capture(3), "options": options });
    let reply = server.post_json("/v1/jobs", &order, &[]);
    reply.expect(422).json()
}

#[test]
fn an_unknown_option_is_refused_with_a_pointer_to_it() {
    let server = Server::start();
    let post = |options: serde_json::Value| refused(&server, &options);
    assert_eq!(post(json!({ "turbo": true }))["pointer"], "/options/turbo");
    assert_eq!(post(json!({ "rounds": 99 }))["pointer"], "/options/rounds");
    assert_eq!(
        post(json!({ "deblur_unguided": "a.onnx" }))["pointer"],
        "/options/deblur_unguided"
    );
}

#[test]
fn an_unknown_network_is_refused_with_the_known_ones() {
    let server = Server::start();
    let post = |options: serde_json::Value| refused(&server, &options);
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
}

#[test]
fn an_order_that_is_none_is_refused() {
    let server = Server::start();
    let capture = server.capture(3);
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
    let refused = refused(&server, &json!({ "deblur": "mine" }));
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
