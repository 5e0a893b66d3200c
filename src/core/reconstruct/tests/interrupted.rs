//! Tests of rounds that stop, resume, or do not begin.

use std::cell::RefCell;

use super::*;

#[test]
fn a_round_resumed_from_a_checkpoint_ends_in_the_same_bytes() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [64, 48]);
    let shake = Some(Response::srgb());
    let config = TrainConfig {
        resolution_schedule: true,
        shake,
        refine_poses: Some(3.0),
        ..config(150, 400)
    };
    let stops = [25, 60, 125];
    resumes(&Device::Processor, &views, &scene, &config, &stops);
    let classic = TrainConfig { densify: Densify::Classic, shake: None, ..config };
    resumes(&Device::Processor, &views, &scene, &classic, &stops);
    // `a_stopped_round_resumes_at_its_step_to_the_same_bytes` has a GPU with shake and cameras.
    resumes(&gpu(), &views, &scene, &classic, &stops[1..2]);
}

#[test]
fn a_round_with_a_noise_field_resumes_to_the_same_bytes() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[-0.3, 0.3], [13, 12]);
    let config = TrainConfig { noise: NoiseMode::Paper, ..config(110, 100) };
    // The noise map is inspected after 100 steps.
    resumes(&Device::Processor, &views, &scene, &config, &[50, 100]);
    resumes(&gpu(), &views, &scene, &config, &[100]);
}

/// The software driver of CI takes seconds for work that the processor does instantly, so a GPU
/// has few stops.
fn resumes(
    device: &Device,
    views: &[TrainingView],
    scene: &Gaussians,
    config: &TrainConfig,
    stops: &[u32],
) {
    let undisturbed = trained_on(device, views, start(views, scene, config), config);
    for &stop in stops {
        let begin = start(views, scene, config);
        let trainer = trainer::Trainer::new(device, views, begin, config).expect("made");
        let frozen = trainer.frozen_at(stop).to_bytes("x");
        let thawed = Checkpoint::from_bytes(&frozen, "x").expect("a checkpoint");
        let resumed = trained_on(device, views, TrainStart::Resume(thawed), config);
        let is_same = bytes(&resumed.gaussians) == bytes(&undisturbed.gaussians);
        assert!(is_same, "stopped at {stop} on {device}");
        assert_eq!(resumed.cameras, undisturbed.cameras, "stopped at {stop} on {device}");
    }
}

#[test]
fn a_stopped_round_resumes_at_its_step_to_the_same_bytes() {
    stops(&gpu(), &[76], &[90]);
    stops(&Device::Processor, &[1, 74, 75, 76, 100, 150], &[50, 60, 90, 100]);
}

/// `after` steps, and `between` two of them.
fn stops(device: &Device, after: &[u32], between: &[u32]) {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [64, 48]);
    let config = TrainConfig {
        resolution_schedule: true,
        shake: Some(Response::srgb()),
        refine_poses: Some(3.0),
        ..config(150, 400)
    };
    let begin = || {
        let begin = start(&views, &scene, &config);
        trainer::Trainer::new(device, &views, begin, &config).expect("made")
    };
    let undisturbed = trained_on(device, &views, start(&views, &scene, &config), &config);
    let goes_on = |checkpoint: &Checkpoint, stop: u32| {
        let thawed = Checkpoint::from_bytes(&checkpoint.to_bytes("x"), "x").expect("a checkpoint");
        let resumed = trained_on(device, &views, TrainStart::Resume(thawed), &config);
        assert!(checkpoint.seconds > 0.0 && resumed.seconds > checkpoint.seconds);
        assert!(bytes(&resumed.gaussians) == bytes(&undisturbed.gaussians), "stopped at {stop}");
        assert_eq!(resumed.cameras, undisturbed.cameras, "stopped at {stop}");
    };
    // No checkpoint is due by the clock.
    for &stop in after {
        let kept = begin().stopped_at(stop, false);
        let steps: Vec<u32> = kept.iter().map(|checkpoint| checkpoint.step).collect();
        assert_eq!(steps, [stop]);
        goes_on(&kept[0], stop);
    }
    // During the work between two steps.
    for &stop in between {
        let kept = begin().stopped_at(stop, true);
        assert_eq!(kept.len(), 1, "stopped at {stop}");
        goes_on(&kept[0], stop);
    }
    // A resumed round that has not trained yet hands over no checkpoint.
    let first = begin().stopped_at(37, false).remove(0);
    let resume = TrainStart::Resume(first);
    let again = trainer::Trainer::new(device, &views, resume, &config).expect("made");
    let cancel = CancelToken::new();
    cancel.cancel();
    let mut kept = 0;
    let mut hooks = TrainHooks {
        cancel: &cancel,
        progress: &mut |_, _, _| {},
        checkpoint: Some(&mut |_| kept += 1),
        seen: None,
        look: None,
    };
    let outcome = again.run(&mut hooks);
    assert!(matches!(outcome, Err(ReconstructError::Cancelled(_))));
    assert_eq!(kept, 0);
}

#[test]
fn a_round_stopped_at_an_overflow_resumes_to_the_same_bytes() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.3], [64, 48]);
    let config = config(40, 400);
    let begin = || {
        let begin = start(&views, &scene, &config);
        let trainer = trainer::Trainer::new(&gpu(), &views, begin, &config);
        trainer.expect("made").with_intersections(50)
    };
    let cancel = CancelToken::new();
    let mut hooks = TrainHooks {
        cancel: &cancel,
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    let undisturbed = begin().run(&mut hooks).expect("trains");
    let mut went_on = 0;
    for stop in 1..8 {
        let kept = begin().stopped_at(stop, false).remove(0);
        went_on += kept.step - stop;
        let resumed = trained_on(&gpu(), &views, TrainStart::Resume(kept), &config);
        assert!(bytes(&resumed.gaussians) == bytes(&undisturbed.gaussians), "stopped at {stop}");
    }
    assert!(went_on > 0, "no step had to be repeated");
}

#[test]
fn a_round_has_the_steps_that_a_look_gives_it_and_resumes_to_them() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[-0.1, 0.1], [64, 48]);
    let config = config(60, 400);
    for steps in [40, 90] {
        let mut kept = None;
        let mut hooks = TrainHooks {
            cancel: &CancelToken::new(),
            progress: &mut |_, _, _| {},
            checkpoint: Some(&mut |checkpoint| {
                if checkpoint.step == 25 {
                    kept = Some(checkpoint.clone());
                }
            }),
            seen: None,
            look: Some(&mut |look: &mut Look<'_>| {
                if look.step == 25 {
                    assert_eq!(look.steps, 60);
                    look.change_steps(steps);
                }
                Ok(())
            }),
        };
        let begin = start(&views, &scene, &config);
        let trainer = trainer::Trainer::new(&Device::Processor, &views, begin, &config);
        let changed = trainer.expect("made").often_kept().run(&mut hooks).expect("trains");
        let resume = TrainStart::Resume(kept.expect("kept after the change"));
        let resumed = trained_on(&Device::Processor, &views, resume, &config);
        assert_eq!([changed.steps, resumed.steps], [u64::from(steps); 2]);
        assert!(bytes(&resumed.gaussians) == bytes(&changed.gaussians), "{steps} steps");
    }
}

#[test]
fn cancelling_stops_a_round_between_steps() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[0.0], [64, 48]);
    let config = config(1_000_000, 100);
    let cancel = CancelToken::new();
    let stop = cancel.clone();
    let mut progress = |_: u64, _: u64, _: f64| stop.cancel();
    let mut hooks = TrainHooks {
        cancel: &cancel,
        progress: &mut progress,
        checkpoint: None,
        seen: None,
        look: None,
    };
    let begin = start(&views, &scene, &config);
    let outcome = train(&Device::Processor, &views, begin, &config, &mut hooks);
    assert!(matches!(outcome, Err(ReconstructError::Cancelled(_))));
}

#[test]
fn no_views_no_gaussians_and_a_foreign_checkpoint_are_refused() {
    let scene = truth(60, 2);
    let views = views_of(&scene, &[0.0], [64, 48]);
    let plain = config(30, 100);
    let cancel = CancelToken::new();
    let mut hooks = TrainHooks {
        cancel: &cancel,
        progress: &mut |_, _, _| {},
        checkpoint: None,
        seen: None,
        look: None,
    };
    let begin = start(&views, &scene, &plain);
    let mut refused = |views: &[TrainingView], start| {
        train(&Device::Processor, views, start, &plain, &mut hooks).expect_err("refused")
    };
    assert!(matches!(refused(&[], begin.clone()), ReconstructError::Empty { views: 0, .. }));
    let nothing = TrainStart::Fresh(Gaussians { sh_degree: 1, ..Gaussians::default() });
    assert!(matches!(refused(&views, nothing), ReconstructError::Empty { gaussians: 0, .. }));
    let other = TrainConfig { seed: 99, ..plain.clone() };
    let foreign = trainer::Trainer::new(&Device::Processor, &views, begin, &other)
        .expect("made")
        .frozen_at(25);
    assert!(matches!(refused(&views, TrainStart::Resume(foreign)), ReconstructError::OtherRound));
}

#[test]
fn a_round_in_parts_equals_the_whole_round() {
    let scene = truth(200, 11);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [64, 48]);
    let config = config(60, 300);
    let TrainStart::Fresh(first) = start(&views, &scene, &config) else { panic!("fresh") };
    let whole = trained(&views, TrainStart::Fresh(first.clone()), &config);
    let mut stepper =
        Stepper::new(&Device::Processor, &views, first.clone(), &config, 0).expect("made");
    let cancel = CancelToken::new();
    for part in [1, 24, 30, 2] {
        stepper.advance(part, &cancel).expect("trains");
    }
    assert_ne!(bytes(&stepper.gaussians()), bytes(&whole.gaussians), "three steps are missing");
    stepper.advance(1_000, &cancel).expect("trains");
    assert_eq!(bytes(&stepper.gaussians()), bytes(&whole.gaussians));
    assert!(stepper.counts().expect("read").intersections > 0);
    cancel.cancel();
    assert!(matches!(stepper.advance(1, &cancel), Err(ReconstructError::Cancelled(_))));
}

#[test]
fn a_round_that_runs_out_of_memory_goes_on_with_half_the_gaussians() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[-0.3, 0.0, 0.3], [64, 48]);
    let mut config = TrainConfig { resolution_schedule: true, ..config(30, 24_000) };
    let begin = || TrainStart::Fresh(repeated(&scene, 13_000));
    let enough = Gpu::new("auto").expect("an adapter");
    let made = trainer::Trainer::new(&Device::Gpu(enough.clone()), &views, begin(), &config);
    let at_first = enough.memory().now;
    drop(made);
    trained_on(&Device::Gpu(enough.clone()), &views, begin(), &config);
    // Enough to begin, not enough for images of the full size, which come later.
    let room = enough.memory().peak - 1;
    assert!(room > at_first);
    let device = Device::Gpu(Gpu::memory_at_most("auto", room).expect("an adapter"));

    let (kept, mut starts, mut told) = (RefCell::new(None), Vec::new(), Vec::new());
    let trained = within_memory(
        &device,
        begin(),
        &mut config,
        &mut |start, config| {
            starts.push(match &start {
                TrainStart::Fresh(gaussians) => (None, gaussians.len(), config.cap),
                TrainStart::Resume(found) => (Some(found.step), found.state.count(), config.cap),
            });
            let mut keep = |checkpoint: &Checkpoint| {
                kept.replace(Some(checkpoint.clone()));
            };
            let mut hooks = TrainHooks {
                cancel: &CancelToken::new(),
                progress: &mut |_, _, _| {},
                checkpoint: Some(&mut keep),
                seen: None,
                look: None,
            };
            trainer::Trainer::new(&device, &views, start, config)?.often_kept().run(&mut hooks)
        },
        &mut |why| {
            told.push(why);
            kept.take()
        },
    );
    let trained = trained.expect("trained");
    let [(None, 13_000, 24_000), (Some(step), 12_000, 12_000)] = starts[..] else {
        panic!("{starts:?}")
    };
    assert!(step > 0, "it goes on from the checkpoint");
    assert!(trained.gaussians.len() <= 12_000 && trained.steps == 30);
    let [why] = &told[..] else { panic!("{told:?}") };
    assert!(why.contains("with at most 12000 Gaussians instead of 24000"), "{why}");
}

/// That many Gaussians in the places of the scene's.
fn repeated(scene: &Gaussians, count: usize) -> Gaussians {
    let indices: Vec<usize> = (0..count).map(|i| i % scene.len()).collect();
    scene.select(&indices)
}

#[test]
fn a_device_too_small_for_few_gaussians_reports_that() {
    let scene = truth(120, 2);
    let views = views_of(&scene, &[0.0], [64, 48]);
    let device = Device::Gpu(Gpu::memory_at_most("auto", 100_000).expect("an adapter"));
    let mut config = config(10, 40_000);
    let mut attempts = 0;
    let outcome = within_memory(
        &device,
        TrainStart::Fresh(scene),
        &mut config,
        &mut |start, config| {
            attempts += 1;
            let made = trainer::Trainer::new(&device, &views, start, config);
            Err(made.err().expect("there is too little memory"))
        },
        &mut |_| None,
    );
    let Err(ReconstructError::Gpu(error)) = outcome else { panic!("it trained") };
    assert!(error.to_string().contains("out of GPU memory"), "{error}");
    assert_eq!((attempts, config.cap), (3, 10_000));
}
