//! The shake for processors against the reference.

use fled_cpu::shake::Shake;

use super::*;

/// The shaken image and the gradient, each by the processor's kernels and by the reference.
fn compare(
    kernel: &ShakeKernel,
    response: &Response,
    size: [usize; 2],
) -> [(Vec<f32>, Vec<f64>); 2] {
    let render = picture(size[0], size[1]);
    let upstream: Vec<f32> =
        (0..render.data().len()).map(|i| (0.37 * i as f32).sin() * 1e-3).collect();
    let mut shake = Shake::default();
    let smooth = [(SMOOTH_WEIGHT / render.data().len() as f64) as f32, SMOOTH_BEND as f32];
    let (taps, table) = (kernel.on_processor(size), response.on_processor());
    // Twice: nothing may depend on the leftovers of a larger image.
    let large = picture(80, 70);
    shake.forward(large.data(), &kernel.on_processor([80, 70]), &table);
    shake.forward(render.data(), &taps, &table);
    shake.backward(render.data(), &upstream, &taps, &table, smooth);
    let reference = ReferenceShake { size, kernel, response };
    let values = wide(render.data());
    [
        (shake.blurred, reference.shaken(&values)),
        (shake.render_gradient, reference.gradient(&values, &wide(&upstream))),
    ]
}

#[test]
fn image_and_gradient_match_the_reference() {
    let far = ShakeKernel::new(vec![Tap::even([0, 0], 1.0), Tap::even([-70, 50], 1.0)]);
    let cases = [
        (curve(), response(), [61, 43]),
        (ShakeKernel::still(), Response::srgb(), [61, 43]),
        (turn(), response(), [61, 43]),
        (turn(), response(), [43, 61]),
        (turn(), response(), [7, 5]),
        (far, Response::srgb(), [61, 43]),
    ];
    for (kernel, response, size) in cases {
        let [image, gradient] = compare(&kernel, &response, size);
        assert_agrees("image", &image.0, &image.1, 1e-5);
        assert_agrees("gradient", &gradient.0, &gradient.1, 1e-4);
    }
}

#[test]
fn the_comparison_detects_a_mirrored_kernel() {
    let mirrored = |tap: &Tap| Tap { offset: tap.offset.map(|o| -o), ..*tap };
    let other = ShakeKernel::new(curve().taps().iter().map(mirrored).collect());
    let ([image, gradient], [wrong, wrong_gradient]) =
        (compare(&curve(), &response(), [61, 43]), compare(&other, &response(), [61, 43]));
    assert!(!agreement(&image.0, &wrong.1).within(1e-3));
    assert!(!agreement(&gradient.0, &wrong_gradient.1).within(1e-2));
}
