//! Tests of the crate on a real device. They fail without an adapter.

use super::*;

const AXPY: Kernel =
    Kernel::new("shared/test_axpy", &[uniform("scale"), read("x"), read_write("out")]);

#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Scale {
    factor: f32,
    count: u32,
}

fn gpu() -> Gpu {
    Gpu::new("auto").expect("an adapter")
}

#[test]
fn a_recording_can_be_submitted_again_and_sees_new_uniforms() {
    let gpu = gpu();
    let n = 70_000;
    let scale = gpu.upload("scale", &[Scale { factor: 2.0, count: n as u32 }]).unwrap();
    let x = gpu.upload("x", &(0..n).map(|i| i as f32).collect::<Vec<_>>()).unwrap();
    let out = gpu.create::<f32>("out", n).unwrap();
    let mut recorder = gpu.recorder();
    recorder.dispatch_items(&AXPY, &[&scale, &x, &out], n).unwrap();
    let recording = recorder.finish();
    recording.submit().unwrap();
    scale.write(&[Scale { factor: 1.0, count: 10 }]).unwrap();
    recording.submit().unwrap();
    let values = out.read().unwrap();
    assert_eq!((values[9], values[10], values[n - 1]), (27.0, 20.0, 2.0 * (n - 1) as f32));
    out.clear().unwrap();
    assert_eq!(out.start_read(2).unwrap().wait().unwrap(), [0.0, 0.0]);
}

#[test]
fn dispatches_and_indirect_counts_see_earlier_results() {
    let gpu = gpu();
    let scale = gpu.upload("scale", &[Scale { factor: 1.0, count: 128 }]).unwrap();
    let x = gpu.upload("x", &[1.0_f32; 128]).unwrap();
    let out = gpu.create::<f32>("out", 128).unwrap();
    let twice = gpu.create::<f32>("twice", 128).unwrap();
    let arguments = gpu.upload("arguments", &[7, 1, 1, 1_u32]).unwrap();
    let mut recorder = gpu.recorder();
    recorder.dispatch(&AXPY.with(&[("ADD", 5)]), &[&scale, &x, &out], [2, 1, 1]).unwrap();
    recorder.dispatch_indirect(&AXPY, &[&scale, &out, &twice], &arguments, 1).unwrap();
    recorder.submit().unwrap();
    let values = twice.read().unwrap();
    assert_eq!((values[0], values[63], values[64]), (5.0, 5.0, 0.0));
}

#[test]
fn bind_groups_are_reused_until_a_buffer_is_dropped() {
    let gpu = gpu();
    let scale = gpu.upload("scale", &[Scale { factor: 3.0, count: 2 }]).unwrap();
    let x = gpu.upload("x", &[1.0_f32, 2.0]).unwrap();
    let record = |out: &Buffer<f32>| {
        let mut recorder = gpu.recorder();
        recorder.dispatch_items(&AXPY, &[&scale, &x, out], 2).unwrap();
        recorder.submit().unwrap();
        out.read().unwrap()
    };
    let (first, second) =
        (gpu.create::<f32>("out", 2).unwrap(), gpu.create::<f32>("out", 2).unwrap());
    let clone = first.clone();
    // The kernel adds to the existing values.
    let sums = [&first, &first, &clone, &second, &second].map(record);
    assert_eq!(sums.map(|s| s[1]), [6.0, 12.0, 18.0, 6.0, 12.0]);
    assert_eq!(gpu.inner.groups.len(), 2);
    drop(first);
    assert_eq!(gpu.inner.groups.len(), 2, "a clone is left");
    drop(clone);
    assert_eq!(gpu.inner.groups.len(), 1);
    drop(second);
    assert_eq!(gpu.inner.groups.len(), 0);
}

#[test]
fn a_dispatch_refuses_missing_wrong_and_aliased_buffers() {
    let gpu = gpu();
    let scale = gpu.upload("scale", &[Scale { factor: 1.0, count: 1 }]).unwrap();
    let x = gpu.upload("x", &[1.0_f32]).unwrap();
    let odd = gpu.upload("odd", &[[1_u8; 3]; 4]).unwrap();
    let mut recorder = gpu.recorder();
    let mut refused = |buffers: &[&dyn Bind]| {
        let result = recorder.dispatch(&AXPY, buffers, [1, 1, 1]);
        assert!(matches!(result, Err(GpuError::Binding { .. })), "{result:?}");
    };
    refused(&[&scale, &x]);
    refused(&[&scale, &x, &x]);
    refused(&[&scale, &odd, &x]);
    refused(&[&x, &odd, &x]);
    assert!(recorder.dispatch(&AXPY, &[&scale, &x, &x], [70_000, 1, 1]).is_err());
    gpu.check().unwrap();
}

#[test]
fn an_unknown_adapter_is_refused_with_the_available_names() {
    match Gpu::new("no such adapter") {
        Err(GpuError::NoAdapter { found, .. }) => assert!(!found.is_empty()),
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("an adapter of that name exists"),
    }
}

#[test]
fn a_buffer_above_the_limit_and_a_write_past_the_end_are_errors() {
    let gpu = gpu();
    let limit = gpu.describe().max_binding as usize;
    assert!(matches!(gpu.create::<u8>("huge", limit + 1), Err(GpuError::TooLarge { .. })));
    let small = gpu.create::<u32>("small", 2).unwrap();
    assert!(matches!(small.write_at(1, &[1, 2]), Err(GpuError::Validation(_))));
    assert!(gpu.create::<u32>("empty", 0).unwrap().read().unwrap().is_empty());
}

#[test]
fn a_lost_device_is_always_an_error_and_never_a_panic() {
    let gpu = gpu();
    let x = gpu.upload("x", &[1.0_f32]).unwrap();
    gpu.lose();
    assert!(matches!(x.read(), Err(GpuError::DeviceLost(_))));
    assert!(matches!(gpu.create::<f32>("y", 1).map(|_| ()), Err(GpuError::DeviceLost(_))));
    assert!(matches!(gpu.wait(), Err(GpuError::DeviceLost(_))));
    assert!(gpu.recorder().submit().is_err());
}

#[test]
fn profiled_kernels_have_a_count_and_a_time() {
    let gpu = gpu();
    let n = 1 << 20;
    let scale = gpu.upload("scale", &[Scale { factor: 2.0, count: n as u32 }]).unwrap();
    let x = gpu.create::<f32>("x", n).unwrap();
    let out = gpu.create::<f32>("out", n).unwrap();
    gpu.profile(true);
    for _ in 0..2 {
        let mut recorder = gpu.recorder();
        recorder.dispatch_items(&AXPY, &[&scale, &x, &out], n).unwrap();
        recorder.submit().unwrap();
    }
    let times = gpu.profiled();
    if gpu.describe().timestamps {
        assert_eq!((times.len(), times[0].0, times[0].1.dispatches), (1, "shared/test_axpy", 2));
        assert!(times[0].1.total >= 2 * times[0].1.shortest && !times[0].1.shortest.is_zero());
    }
    gpu.profile(false);
    assert!(gpu.profiled().is_empty());
}

#[test]
fn a_submission_larger_than_a_query_set_is_timed_completely() {
    let gpu = gpu();
    let scale = gpu.upload("scale", &[Scale { factor: 2.0, count: 1 }]).unwrap();
    let x = gpu.upload("x", &[1.0_f32]).unwrap();
    let out = gpu.create::<f32>("out", 1).unwrap();
    let mut recorder = gpu.recorder();
    for _ in 0..2_100 {
        recorder.dispatch_items(&AXPY, &[&scale, &x, &out], 1).unwrap();
    }
    gpu.profile(true);
    recorder.submit().unwrap();
    assert_eq!(gpu.profiled()[0].1.dispatches, 2_100);
}

#[test]
fn memory_counts_live_buffers_and_the_peak() {
    let gpu = gpu();
    let before = gpu.memory().now;
    let kept = gpu.create::<f32>("kept", 1_000).unwrap();
    let copy = kept.clone();
    drop(gpu.create::<f32>("dropped", 500).unwrap());
    drop(kept);
    assert_eq!(gpu.memory().now - before, 4_000);
    assert_eq!(gpu.memory().peak - before, 6_000);
    gpu.forget_peak();
    drop(copy);
    assert_eq!((gpu.memory().now, gpu.memory().peak - before), (before, 4_000));
}
