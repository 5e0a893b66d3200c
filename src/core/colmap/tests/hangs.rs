//! COLMAP that never exits, or is cancelled.

use super::*;

/// A child and a grandchild that both sleep, with their process ids in files.
const HANG: &str = r#"
if [ $command = feature_extractor ]; then
  here=$(dirname "$0"); sleep 600 & echo $! > "$here/grandchild"; echo $$ > "$here/child"; wait
fi; exit 0"#;

fn alive(pid_file: &Path) -> bool {
    let pid = std::fs::read_to_string(pid_file).unwrap();
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", pid.trim())).unwrap_or_default();
    // A zombie that its new parent has not reaped yet counts as dead.
    !stat.is_empty() && !stat.contains(") Z ")
}

fn assert_nothing_left(scene: &Scene) {
    for name in ["child", "grandchild"] {
        let file = scene.dir.path().join(name);
        let gone = (0..100).any(|_| {
            std::thread::sleep(Duration::from_millis(20));
            !alive(&file)
        });
        assert!(gone, "the {name} lives on");
    }
}

#[test]
#[should_panic(expected = "the child lives on")]
fn a_surviving_process_is_detected() {
    let scene = Scene::new(5, "");
    std::fs::write(scene.dir.path().join("child"), std::process::id().to_string()).unwrap();
    assert_nothing_left(&scene);
}

#[test]
fn a_hang_ends_in_a_timeout_that_leaves_no_process_behind() {
    let scene = Scene::new(5, HANG);
    let limits = Limits { wall: Duration::from_secs(60), silence: Duration::from_secs(1) };
    let outcome = scene.run(&scene.tool().with_limits(limits), &mut Silent, &CancelToken::new());
    assert!(
        matches!(outcome, Err(PosesError::Timeout { why: "without output", .. })),
        "{outcome:?}"
    );
    assert_nothing_left(&scene);
}

#[test]
fn endless_output_hits_the_wall_limit_and_a_bounded_log() {
    let scene = Scene::new(
        5,
        "[ $command = feature_extractor ] && exec yes 'a line that says nothing'; exit 0",
    );
    let limits = Limits { wall: Duration::from_secs(3), silence: Duration::from_secs(60) };
    let outcome = scene.run(&scene.tool().with_limits(limits), &mut Silent, &CancelToken::new());
    assert!(matches!(outcome, Err(PosesError::Timeout { why: "in all", .. })), "{outcome:?}");
    assert!(scene.log().len() < 9 << 20);
}

#[test]
fn a_cancellation_takes_effect_within_a_second_and_leaves_no_process() {
    let scene = Scene::new(5, HANG);
    let cancel = CancelToken::new();
    let token = cancel.clone();
    let child = scene.dir.path().join("child");
    let canceller = std::thread::spawn(move || {
        while !child.exists() {
            std::thread::sleep(Duration::from_millis(10));
        }
        token.cancel();
        Instant::now()
    });
    let outcome = scene.run(&scene.tool(), &mut Silent, &cancel);
    let ended = Instant::now();
    assert!(matches!(outcome, Err(PosesError::Cancelled(_))), "{outcome:?}");
    assert!(ended - canceller.join().unwrap() < Duration::from_secs(1));
    assert_nothing_left(&scene);
}
