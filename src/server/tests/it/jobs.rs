//! Jobs through a real server process: how they end, fail, are stopped, and survive kill -9.

use std::time::{Duration, Instant};

use crate::support::{Part, Server, gone, photographs, processes_of, text};
use serde_json::json;

#[test]
fn a_job_goes_from_upload_to_results() {
    let server = Server::start();
    let mut parts = photographs(4);
    parts.extend([
        text("preset", "preview"),
        text("options", r#"{"adapter":"ok","seed":7}"#),
        text("name", "a <b>walk</b>"),
    ]);
    let reply = server.upload("/v1/jobs", &parts, &[]).expect(202);
    let job = reply.json()["id"].as_str().expect("id").to_owned();
    assert_eq!(reply.location(), format!("/v1/jobs/{job}"));
    let done = server.wait_state(&job, "succeeded");
    assert_eq!(
        (&done["progress"], &done["rounds"], &done["best_round"]),
        (&1.0.into(), &2.into(), &2.into())
    );
    assert_eq!(done["name"], "a <b>walk</b>");
    assert_eq!(done["warnings"][0]["code"], "low_confidence");
    assert_eq!(done["options"]["seed"], 7);
    let page = server.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(page["jobs"][0], done, "a page tells of a job what the job does");
    assert_eq!(
        done["stages"].as_array().expect("stages").len(),
        13,
        "poses and six stages of two rounds"
    );
    let rounds = server.get(&format!("/v1/jobs/{job}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().expect("rounds").len(), 2);
    assert_eq!((&rounds["seed"], &rounds["best_round"]), (&7.into(), &2.into()));
    let csv = server.get(&format!("/v1/jobs/{job}/rounds?format=csv"), &[]).expect(200).text();
    // Without ground truth: the enhanced and the deblurred views, and the renders.
    // Without ground truth a round has the renders of two splits, and a row per photograph.
    assert_eq!(csv.lines().count(), 1 + 2 * (2 + 4));
    let log = server.get(&format!("/v1/jobs/{job}/log?limit=3"), &[]).expect(200).json();
    assert_eq!((log["lines"].as_array().expect("lines").len(), &log["end"]), (3, &false.into()));
}

#[test]
fn a_job_can_be_renamed_and_tagged_and_shows_its_score() {
    let server = Server::start();
    let mut parts = photographs(4);
    let truth = |(_, name, content): Part| ("gt".to_owned(), name, content);
    parts.extend(photographs(4).into_iter().map(truth));
    parts.push(text("options", r#"{"adapter":"ok","rounds":2}"#));
    let made = server.upload("/v1/jobs", &parts, &[]).expect(202).json();
    let job = made["id"].as_str().expect("id");
    let path = format!("/v1/jobs/{job}");
    let ask = |path: &str, body: &serde_json::Value| {
        let json = [("content-type", "application/json")];
        server.ask("PATCH", path, &json, body.to_string().as_bytes())
    };
    let named = ask(&path, &json!({ "name": "Küche" })).expect(200).json();
    assert_eq!((&named["name"], &named["tags"]), (&json!("Küche"), &json!([])));
    let tagged = ask(&path, &json!({ "tags": [" hall ", "Nacht", "hall"] })).expect(200).json();
    assert_eq!((&tagged["name"], &tagged["tags"]), (&json!("Küche"), &json!(["hall", "Nacht"])));
    let ended = server.wait_state(job, "succeeded");
    assert_eq!(ended["name"], "Küche");
    let score =
        json!({ "reference": "gt", "split": "held_out", "psnr_cc_db": 20.5, "ssim": 0.4875 });
    assert_eq!(ended["score"], score, "of the second round's held-out views");
    ask(&path, &json!({ "name": "b" })).expect(200);
    let page = server.get("/v1/jobs", &[]).expect(200).json();
    assert_eq!(page["jobs"][0]["name"], "b");
    assert_eq!(page["jobs"][0]["tags"], json!(["hall", "Nacht"]));
    assert_eq!(page["jobs"][0]["score"], score);
    for wrong in ["", "a\n", &"x".repeat(201)] {
        let refused = ask(&path, &json!({ "name": wrong })).expect(422).json();
        assert_eq!(refused["pointer"], "/name", "{refused:#}");
    }
    let many: Vec<String> = (0..21).map(|i| i.to_string()).collect();
    for wrong in [json!([" "]), json!(["a\n"]), json!(["x".repeat(51)]), json!(many)] {
        let refused = ask(&path, &json!({ "name": "c", "tags": wrong })).expect(422).json();
        let pointer = refused["pointer"].as_str().expect("pointer");
        assert!(pointer.starts_with("/tags"), "{refused:#}");
    }
    assert_eq!(ask(&path, &json!({})).expect(200).json()["name"], "b", "nothing changes");
    ask(&path, &json!({ "name": "c", "state": "failed" })).expect(422);
    ask("/v1/jobs/none", &json!({ "name": "c" })).expect(404);
}

#[test]
fn a_permanent_failure_is_reported_at_once_with_a_hint() {
    let server = Server::start();
    let job = server.job("few_poses");
    let failed = server.wait_state(&job, "failed");
    assert_eq!(failed["attempts"], 1);
    assert_eq!(failed["error"]["code"], "few_poses");
    assert_eq!(failed["error"]["detail"], "3 of 20 photographs could be placed");
    assert_eq!(failed["error"]["hint"], "Take more.");
}

#[test]
fn a_job_with_too_little_overlap_tells_which_photographs_match() {
    let server = Server::start();
    let job = server.job("apart");
    let failed = server.wait_state(&job, "failed");
    let overlap = &failed["overlap"];
    let groups = overlap["groups"].as_array().expect("groups");
    assert!(groups[0].as_array().is_some_and(|group| group.len() == 4), "{overlap}");
    let [first, second] = [&groups[0][0], &groups[0][1]];
    let link = json!({ "first": first, "second": second, "matches": 240, "connects": true });
    assert_eq!(overlap["links"][0], link);
    let listed = server.get("/v1/jobs", &[]).expect(200).json();
    assert!(listed["jobs"][0].get("overlap").is_none(), "lists stay small");
    server.post_json(&format!("/v1/jobs/{job}/retry"), &json!({}), &[]).expect(202);
    server.wait_state(&job, "failed");
    let other = server.job("few_poses");
    assert!(server.wait_state(&other, "failed").get("overlap").is_none());
}

#[test]
fn a_job_fails_after_three_crashes_without_progress() {
    let server = Server::start();
    let once = server.job("crash-once");
    let late = server.job("crash-late");
    let always = server.job("crash");
    let unknown = server.job("bad_word");
    assert_eq!(server.wait_state(&once, "succeeded")["attempts"], 2);
    assert_eq!(server.wait_state(&late, "succeeded")["attempts"], 2);
    let failed = server.wait_state(&always, "failed");
    assert_eq!((&failed["attempts"], &failed["error"]["code"]), (&3.into(), &"internal".into()));
    assert_eq!(server.wait_state(&unknown, "failed")["error"]["code"], "internal");
}

#[test]
fn cancelling_takes_two_seconds_at_most_and_a_retry_resumes() {
    let server = Server::start();
    let job = server.job("slow:100");
    server.wait(&job, "in round 1", |shown| shown["round"] == 1);
    let start = Instant::now();
    let reply = server.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]).expect(202).json();
    assert!(start.elapsed() < Duration::from_secs(2), "{:?}", start.elapsed());
    assert_eq!(reply["state"], "cancelled");
    assert_eq!(processes_of(&job), 0);
    server.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]).expect(409);
    server.post(&format!("/v1/jobs/{job}/retry"), b"", &[]).expect(202);
    let log = || server.get(&format!("/v1/jobs/{job}/log"), &[]).expect(200).text();
    let again = server.wait(&job, "past its poses again", |_| log().contains("poses already done"));
    assert_eq!(again["attempts"], 2);
    assert_eq!(log().matches("poses done").count(), 1, "the retry began anew: {}", log());
    server.post(&format!("/v1/jobs/{job}/cancel"), b"", &[]).expect(202);
    server.delete(&format!("/v1/jobs/{job}")).expect(204);
    server.get(&format!("/v1/jobs/{job}"), &[]).expect(404);
}

#[test]
fn a_queued_job_is_cancelled_without_starting() {
    let server = Server::start();
    let busy = [server.job("slow:200"), server.job("slow:200")];
    let waiting = server.job("ok");
    let reply = server.post(&format!("/v1/jobs/{waiting}/cancel"), b"", &[]).expect(202).json();
    assert_eq!((&reply["state"], &reply["attempts"]), (&"cancelled".into(), &0.into()));
    server.delete(&format!("/v1/jobs/{}", busy[0])).expect(409);
}

#[test]
fn a_silent_job_is_stopped_with_a_timeout() {
    let server = Server::start();
    let job = server.job("silent");
    let failed = server.wait_state(&job, "failed");
    assert_eq!((&failed["error"]["code"], &failed["attempts"]), (&"timeout".into(), &3.into()));
    assert_eq!(processes_of(&job), 0);
}

#[test]
fn a_job_survives_the_death_of_its_server_with_all_events() {
    let mut server = Server::start();
    let job = server.job("slow:15");
    let mut events: Vec<(i64, String, serde_json::Value)> = Vec::new();
    for round in [1, 2] {
        server
            .wait(&job, "further", |shown| shown["round"] == round && shown["stage"] != "enhance");
        server.kill();
        assert!(gone(&job), "the job's process outlived its server");
        server.restart();
        let last = events.last().map_or(0, |(id, ..)| *id);
        let shown = server.show(&job);
        assert!(shown["state"] == "running" || shown["state"] == "queued", "{shown:#}");
        // The events so far, since the last read.
        events.extend(server.events(&job, last, 7));
    }
    let done = server.wait_state(&job, "succeeded");
    assert_eq!(done["attempts"], 3);
    let last = events.last().map_or(0, |(id, ..)| *id);
    events.extend(server.events(&job, last, usize::MAX));
    let ids: Vec<i64> = events.iter().map(|(id, ..)| *id).collect();
    assert_eq!(ids, (1..=ids.len() as i64).collect::<Vec<_>>(), "a gap or a duplicate");
    assert_eq!(
        events.last().map(|(_, name, data)| (name.as_str(), &data["state"])),
        Some(("state", &"succeeded".into()))
    );
    assert_eq!(
        events.iter().filter(|(_, name, _)| name == "round_finished").count(),
        2 + 1,
        "round 1 is reported again"
    );
    server
        .get(&format!("/v1/jobs/{job}/events"), &[("last-event-id", &ids.len().to_string())])
        .expect(204);
    let rounds = server.get(&format!("/v1/jobs/{job}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().map(Vec::len), Some(2));
}

#[test]
fn accepted_jobs_survive_the_death_of_the_server() {
    let mut server = Server::start();
    let jobs: Vec<String> = (0..5).map(|_| server.job("ok:5")).collect();
    server.restart();
    for job in &jobs {
        server.wait_state(job, "succeeded");
    }
}

#[test]
fn the_same_key_and_request_give_the_same_job() {
    let server = Server::start();
    let capture = server.capture(3);
    let body = serde_json::json!({ "capture_id": capture, "preset": "preview", "options": { "adapter": "ok" } });
    let key = [("idempotency-key", "abc")];
    let first = server.post_json("/v1/jobs", &body, &key).expect(202).json();
    let again = server.post_json("/v1/jobs", &body, &key).expect(202);
    assert_eq!(again.header("idempotent-replayed"), "true");
    assert_eq!(again.json()["id"], first["id"]);
    let other = serde_json::json!({ "capture_id": capture, "preset": "standard" });
    assert_eq!(server.post_json("/v1/jobs", &other, &key).expect(422).json()["code"], "key_reused");
    let key = [("idempotency-key", "def")];
    let first = server.upload("/v1/jobs", &photographs(3), &key).expect(202).json();
    let again = server.upload("/v1/jobs", &photographs(3), &key).expect(202).json();
    assert_eq!(again["id"], first["id"]);
    let captures = server.get("/v1/captures", &[]).expect(200).json();
    assert_eq!(
        captures["captures"].as_array().map(Vec::len),
        Some(2),
        "a copy of the capture stayed"
    );
}

#[test]
fn a_successful_job_can_be_retried_with_other_options() {
    let server = Server::start();
    let job = server.job("ok");
    let before = server.wait_state(&job, "succeeded");
    let path = format!("/v1/jobs/{job}/retry");
    let retry =
        |options: serde_json::Value| server.post_json(&path, &json!({ "options": options }), &[]);
    server.post(&path, b"", &[]).expect(409);
    retry(json!({})).expect(409);
    let same = json!({ "rounds": before["options"]["rounds"] });
    retry(same).expect(409);
    let wrong = retry(json!({ "rounds": 99 })).expect(422).json();
    assert_eq!(wrong["pointer"], "/options/rounds");
    let held_out = retry(json!({ "held_out": "no-such-view" })).expect(422).json();
    assert_eq!(held_out["pointer"], "/options/held_out");
    assert_eq!(server.show(&job)["options"], before["options"], "as it was");
    let last = server.events(&job, 0, usize::MAX).len() as i64;

    let queued = retry(json!({ "rounds": 1, "cap": 4321 })).expect(202).json();
    assert_eq!((&queued["options"]["cap"], &queued["rounds"]), (&json!(4321), &json!(1)));
    let after = server.wait_state(&job, "succeeded");
    assert_eq!((&after["best_round"], &after["attempts"]), (&json!(1), &json!(2)));
    let rounds = server.get(&format!("/v1/jobs/{job}/rounds"), &[]).expect(200).json();
    assert_eq!(rounds["rounds"].as_array().map(Vec::len), Some(1), "{rounds:#}");
    let events = server.events(&job, last, usize::MAX);
    assert_eq!(events[0].1, "state", "the stream goes on: {events:?}");
}

#[test]
fn a_job_with_options_of_an_older_build_can_be_retried() {
    let mut server = Server::start();
    let job = server.job("ok");
    server.wait_state(&job, "succeeded");
    server.kill();
    let mut options = server_options(&server, &job, None);
    options["dropout"] = json!(0.0);
    options["noise"] = json!("grid");
    server_options(&server, &job, Some(&options));
    server.restart();
    assert_eq!(server.show(&job)["options"], options);
    let path = format!("/v1/jobs/{job}/retry");
    let retry = |options| server.post_json(&path, &json!({ "options": options }), &[]);
    let gone = retry(json!({ "cap": 4321 })).expect(422).json();
    assert_eq!(gone["pointer"], "/options/noise");
    let again = json!({ "cap": 4321, "noise": "off" });
    let queued = retry(again).expect(202).json();
    assert_eq!(queued["options"]["dropout"], json!(null));
    server.wait_state(&job, "succeeded");

    server.kill();
    options["noise"] = json!("off");
    server_options(&server, &job, Some(&options));
    let url = format!("sqlite://{}", server.data.path().join("data/fled.db").display());
    on_database(&url, "UPDATE jobs SET state = 'queued', finished_at = NULL");
    server.restart();
    server.wait_state(&job, "succeeded");
}

/// Returns the stored options of a job, after replacing them if `other` is given.
fn server_options(
    server: &Server,
    job: &str,
    other: Option<&serde_json::Value>,
) -> serde_json::Value {
    let url = format!("sqlite://{}", server.data.path().join("data/fled.db").display());
    if let Some(other) = other {
        let order = format!("UPDATE jobs SET options = '{other}' WHERE id = '{job}'");
        on_database(&url, &order);
    }
    let rows = on_database(&url, &format!("SELECT options FROM jobs WHERE id = '{job}'"));
    serde_json::from_str(&rows[0]).expect("JSON")
}

/// The first column of a statement's result.
fn on_database(url: &str, statement: &str) -> Vec<String> {
    sqlx::any::install_default_drivers();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        let pool = sqlx::any::AnyPoolOptions::new().connect(url).await;
        let pool = pool.expect("connected");
        let statement = sqlx::AssertSqlSafe(statement.to_owned());
        let rows = sqlx::query_scalar(statement).fetch_all(&pool).await;
        pool.close().await;
        rows.expect("answered")
    })
}
