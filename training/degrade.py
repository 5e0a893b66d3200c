"""From a sharp photograph to what the network is given: shake, sensor noise, 8 bits, JPEG, tone curve.

All light is linear until `encode`; images are f32 [H, W, 3].
"""

import functools
import io
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.ndimage as nd
from PIL import Image

import tone_curve

# Pixels around a scene that only feed the blur; no kernel reaches further.
MARGIN = 32
KERNEL = 2 * MARGIN - 1


def decode(srgb):
    """sRGB to linear light."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4).astype(np.float32)


def encode(linear):
    """Linear light, clipped to 0..1, to sRGB."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055).astype(np.float32)


def shake_kernel(rng, extent):
    """A smooth camera path of `extent` pixels from end to end of its box, centred on its mean, [63, 63]."""
    samples = 192
    velocity = rng.normal(size=(2, samples))
    velocity = nd.gaussian_filter1d(velocity, rng.uniform(8, 60), axis=1, mode="nearest")
    velocity += rng.normal(size=(2, 1)) * velocity.std() * rng.uniform(0, 2)
    path = np.cumsum(velocity, axis=1)
    span = np.hypot(*(path.max(axis=1) - path.min(axis=1)))
    path = path / max(span, 1e-9) * extent
    path -= path.mean(axis=1, keepdims=True)
    return deposit(path)


def deposit(path):
    """Bilinear footprint of the points `path` [2, n] round the kernel's middle, sum 1."""
    kernel = np.zeros((KERNEL, KERNEL))
    x, y = np.clip(path + MARGIN - 1, 0, KERNEL - 1.001)
    left, top = x.astype(int), y.astype(int)
    across, down = x - left, y - top
    for dy, wy in ((0, 1 - down), (1, down)):
        for dx, wx in ((0, 1 - across), (1, across)):
            np.add.at(kernel, (top + dy, left + dx), wy * wx)
    return kernel / kernel.sum()


def disc_kernel(radius):
    """Defocus: a disc of `radius` pixels with a soft edge."""
    y, x = np.mgrid[:KERNEL, :KERNEL] - (MARGIN - 1)
    kernel = np.clip(radius + 0.5 - np.hypot(x, y), 0, 1)
    return kernel / kernel.sum()


def spectrum(image):
    """Real FFT over the two image axes."""
    return scipy.fft.rfft2(image, axes=(0, 1))


def convolve(image_spectrum, kernel, shape):
    """Circular convolution; what wraps lies within MARGIN, which the caller crops."""
    field = np.zeros(shape, np.float32)
    field[:KERNEL, :KERNEL] = kernel
    field = np.roll(field, (1 - MARGIN, 1 - MARGIN), (0, 1))
    product = image_spectrum * scipy.fft.rfft2(field)[..., None]
    return scipy.fft.irfft2(product, shape, axes=(0, 1))


def smooth_field(rng, shape, cells, channels=1):
    """A smooth random field of unit deviation, [H, W, channels]."""
    coarse = rng.normal(size=(cells + 3, cells + 3, channels)).astype(np.float32)
    zoom = (int(np.ceil(shape[0] / cells)), int(np.ceil(shape[1] / cells)))
    out = np.stack([nd.zoom(coarse[..., c], (zoom[0], zoom[1]), order=1) for c in range(channels)], -1)
    return out[: shape[0], : shape[1]]


@dataclass
class Exposure:
    """One dark photograph: share of the light, sensor noise (variances per unit light and constant), coding."""

    light: float
    shot: float
    read: float
    mosaic: bool = False
    jpeg: int = 0


def sensor(iso, jitter=0.0):
    """Shot and read variance of a phone sensor at `iso`; `jitter` is added to the logarithm of read."""
    shot = 9.2857e-7 * iso + 8.1006e-5
    return shot, float(np.exp(2.2282 * np.log(shot) + 0.45982 + jitter))


def random_exposure(rng):
    """The training distribution of exposures."""
    jitter = rng.normal() * 0.25
    if rng.random() < 0.3:
        # Cheap sensors and old cameras read out far noisier than the fitted line.
        jitter += rng.uniform(0, 2.5)
    shot, read = sensor(np.exp(rng.uniform(np.log(100), np.log(1600))), jitter)
    return Exposure(
        light=float(np.exp(rng.uniform(np.log(0.02), np.log(0.6)))),
        shot=shot,
        read=read,
        mosaic=rng.random() < 0.25,
        jpeg=int(rng.integers(70, 99)) if rng.random() < 0.5 else 0,
    )


def clean_exposure(rng):
    """Enough light: in 70 % nothing but the blur is in the way, else hardly anything."""
    if rng.random() < 0.7:
        return Exposure(1.0, 0.0, 0.0)
    shot, read = sensor(rng.uniform(50, 200)) if rng.random() < 0.2 else (0.0, 0.0)
    jpeg = int(rng.integers(90, 99)) if rng.random() < 0.1 else 0
    return Exposure(light=float(rng.uniform(0.7, 1)), shot=shot, read=read, jpeg=jpeg)


def expose(rng, linear, exposure):
    """The photograph a camera would store, sRGB 0..1 in steps of 1/255 (or as JPEG left it)."""
    signal = np.clip(linear, 0.0, 1.0) * exposure.light
    if exposure.mosaic:
        signal = demosaic(noisy(rng, mosaic(signal), exposure))
    else:
        signal = noisy(rng, signal, exposure)
    stored = np.rint(encode(signal) * 255).astype(np.uint8)
    if exposure.jpeg:
        buffer = io.BytesIO()
        Image.fromarray(stored).save(buffer, "JPEG", quality=exposure.jpeg)
        stored = np.asarray(Image.open(buffer))
    return stored.astype(np.float32) / 255


def noisy(rng, signal, exposure):
    """Signal with shot and read noise, as one Gaussian of the summed variance."""
    if exposure.shot == 0.0 and exposure.read == 0.0:
        return signal
    deviation = np.sqrt(exposure.shot * np.maximum(signal, 0) + exposure.read)
    return signal + deviation * rng.standard_normal(signal.shape, np.float32)


def mosaic(image):
    """Bayer samples (RGGB), zero elsewhere."""
    out = np.zeros_like(image)
    out[0::2, 0::2, 0] = image[0::2, 0::2, 0]
    out[0::2, 1::2, 1] = image[0::2, 1::2, 1]
    out[1::2, 0::2, 1] = image[1::2, 0::2, 1]
    out[1::2, 1::2, 2] = image[1::2, 1::2, 2]
    return out


def demosaic(samples):
    """Bilinear demosaicing. Noise at unsampled places is dropped first."""
    samples = mosaic(samples)
    cross = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]], np.float32) / 4
    square = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]], np.float32) / 4
    kernels = (square, cross, square)
    return np.stack([nd.convolve(samples[..., c], kernels[c], mode="mirror") for c in range(3)], -1)


@dataclass
class Blur:
    """No kernel, one, or two that `mask` [H, W, 1] mixes over the image."""

    kernels: list
    mask: np.ndarray | None = None


def random_blur(rng, shape):
    """The training distribution where light is scarce: 66 % shake, 15 % varying shake, 14 % none, 5 % defocus."""
    kind = rng.random()
    if kind < 0.66:
        # Mostly what a hand does, and as often a pixel as ten: a network that has seen only strong blur sharpens what is sharp.
        short = np.exp(rng.uniform(np.log(0.5), np.log(16)))
        return Blur([shake_kernel(rng, short if rng.random() < 0.9 else rng.uniform(0, 25))])
    if kind < 0.81:
        extent = rng.uniform(2, 20)
        kernels = [shake_kernel(rng, extent * rng.uniform(0.3, 1)) for _ in range(2)]
        ramp = smooth_field(rng, shape, 2)
        return Blur(kernels, 1 / (1 + np.exp(-2 * ramp)))
    if kind < 0.95:
        return Blur([])
    return Blur([disc_kernel(rng.uniform(0.5, 4))])


def clean_blur(rng):
    """The training distribution where there is enough light: shakes that can be undone, in 1.5 % none.

    With a tenth of none the network learns to leave alone whatever might be sharp: that is where the most decibels are to be had.
    Weak shakes teach it how little to do, without that: from 3.5 px on only, it overdid what is hardly shaken.
    """
    return Blur([shake_kernel(rng, rng.uniform(0.7, 13))] if rng.random() < 0.985 else [])


def blur_image(linear, image_spectrum, blur):
    """The linear image under `blur`."""
    if not blur.kernels:
        return linear
    shape = linear.shape[:2]
    parts = [convolve(image_spectrum, kernel, shape) for kernel in blur.kernels]
    if len(parts) == 1:
        return parts[0]
    return parts[0] * blur.mask + parts[1] * (1 - blur.mask)


@dataclass
class Guide:
    """How a simulated render of the previous round differs from the clean image."""

    extent: float
    sigma: float
    drift: float
    warp: float
    grain: float
    # Low pass, px, of the places that too few views have seen.
    smudge: float = 0.0
    # By how much detail stands out too far.
    crisp: float = 0.0


def random_guide(rng):
    """The training distribution of simulated renders: 40 % nearly sharp, 25 % blurred, 35 % poor; 40 % of all too crisp.

    The poor ones are those of few views or steps: 5 to 10 dB worse than their views, which a network has to leave alone. One
    that has met only guides better than their views takes every guide for the truth. Too crisp is the scene of views that a
    network has sharpened: one that has only met blurred guides sharpens them once more.
    """
    kind = rng.random()
    sharp, poor = kind < 0.4, kind >= 0.65
    return Guide(
        extent=rng.uniform(0, 3 if sharp else 14) * rng.random() * (rng.random() < 0.7 or not sharp),
        sigma=rng.uniform(1, 3.5) if poor else rng.uniform(0, 0.7 if sharp else 1.6),
        drift=rng.uniform(0, 0.1 if poor else 0.05),
        warp=rng.uniform(0.5, 4) if poor else rng.uniform(0, 1.2) * rng.random(),
        grain=rng.uniform(0, 0.06 if poor else 0.03) * rng.random(),
        smudge=rng.uniform(1, 5) if rng.random() < (0.6 if poor else 0.2) else 0.0,
        crisp=random_crispness(rng),
    )


def random_crispness(rng):
    """The training distribution of how much too far detail stands out; mostly 0."""
    return rng.uniform(0, 1.2) if rng.random() < 0.4 else 0.0


def crisper(rng, image, amount):
    """Detail below a random size put in `amount` times more."""
    if amount == 0:
        return image
    sigma = rng.uniform(0.7, 2.5)
    return image + amount * (image - nd.gaussian_filter(image, (sigma, sigma, 0)))


def render_light(rng, image_spectrum, shape, guide):
    """Linear light of a simulated render: the mean of several weaker shakes, low-passed."""
    count = int(rng.integers(2, 6))
    kernel = np.mean([shake_kernel(rng, guide.extent * rng.uniform(0.5, 1.2)) for _ in range(count)], 0)
    if guide.sigma > 0.05:
        kernel = nd.gaussian_filter(kernel, guide.sigma)
    return convolve(image_spectrum, kernel / kernel.sum(), shape)


def spoil_render(rng, image, guide):
    """Too crisp or smudged places, a warp, colour drift and smooth grain on the brightened render, 0..1."""
    height, width = image.shape[:2]
    image = crisper(rng, image, guide.crisp)
    if guide.smudge > 0.05:
        where = 1 / (1 + np.exp(-4 * smooth_field(rng, (height, width), 5)))
        image = image + where * (nd.gaussian_filter(image, (guide.smudge, guide.smudge, 0)) - image)
    if guide.warp > 0.02:
        shift = smooth_field(rng, (height, width), 8 if guide.warp > 1.2 else 4, 2) * guide.warp
        y, x = np.mgrid[:height, :width].astype(np.float32)
        place = [y + shift[..., 0], x + shift[..., 1]]
        image = np.stack([nd.map_coordinates(image[..., c], place, order=1, mode="mirror") for c in range(3)], -1)
    gain = 1 + rng.normal(size=3) * guide.drift
    offset = rng.normal(size=3) * guide.drift * 0.5
    patchy = smooth_field(rng, (height, width), 6) * guide.drift * 0.5
    grain = nd.gaussian_filter(rng.standard_normal((height, width, 3), np.float32), (1.2, 1.2, 0)) * 4
    return np.clip(image * gain + offset + patchy + grain * guide.grain, 0, 1).astype(np.float32)


# Side of a cell, px, and the difference at which a render has lost most of its say: the product's (pipeline/guide.rs).
CELL, DISAGREEMENT = 4, 0.04
# Share of the render's detail that the product feeds; training's guides have all.
SHARE = 0.7


def trusted(view, render, share=1.0):
    """The view with a share of the render's detail where the two agree, f32 [H, W, 3] sRGB 0..1 like both of them.

    With all of the detail it is a guide of training, with SHARE of it the product's.
    """
    difference = cells(view) - cells(render)
    trust = enlarged(np.exp(-np.mean(difference**2, 2, keepdims=True) / DISAGREEMENT**2), view.shape)
    return np.clip(view + share * trust * (render + enlarged(difference, view.shape) - view), 0, 1)


@functools.cache
def average(length):
    """[cells, length]: the means of equal cells of at most CELL px, which may share a pixel at their border."""
    count = -(-length // CELL)
    borders = np.arange(count + 1) * length / count
    pixels = np.arange(length)
    overlap = np.minimum(borders[1:, None], pixels + 1) - np.maximum(borders[:-1, None], pixels)
    return (np.maximum(overlap, 0) * count / length).astype(np.float32)


@functools.cache
def interpolation(length):
    """[length, cells]: bilinear between the cells' middles, the first and last cell continued to the border."""
    count = -(-length // CELL)
    place = np.clip((np.arange(length) + 0.5) * count / length - 0.5, 0, count - 1)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0).astype(np.float32)


def along_both(matrices, image):
    """An image under a matrix for its rows and one for its columns."""
    image = np.tensordot(matrices[0], image, (1, 0))
    return np.ascontiguousarray(np.tensordot(matrices[1], image, (1, 1)).swapaxes(0, 1))


def cells(image):
    """Means of the cells: [H, W, C] to [ceil(H / CELL), ceil(W / CELL), C]."""
    return along_both([average(length) for length in image.shape[:2]], image)


def enlarged(coarse, shape):
    """Values of cells [h, w, C] at the pixels of an image of `shape`, [H, W, C]."""
    return along_both([interpolation(length) for length in shape[:2]], coarse)


def pair(rng, light, blur, exposure, target, guide, share=1.0):
    """One example from sharp linear light with MARGIN round it; light above 1 saturates after the blur.

    `target` is (alpha, gamma) of the brightening or None for none; `guide` a Guide or None for a copy; of the
    simulated render's detail the guide has a `share`.
    Returns blurry, guide, clean, each f32 [H - 2 MARGIN, W - 2 MARGIN, 3].
    """
    shape = light.shape[:2]
    frequencies = spectrum(light)
    inner = slice(MARGIN, -MARGIN)
    blurred = blur_image(light, frequencies, blur)[inner, inner]
    dark = expose(rng, blurred, exposure)
    lut, gamma = None, 1.0
    if target is not None:
        lut, gamma = tone_curve.table(tone_curve.histogram([dark]), target[0]), target[1]

    def brighten(linear):
        return tone_curve.apply(encode(np.clip(linear, 0, 1) * exposure.light), lut, gamma)

    blurry = tone_curve.apply(dark, lut, gamma)
    clean = brighten(light[inner, inner])
    if guide is None:
        return blurry, blurry, clean
    render = brighten(render_light(rng, frequencies, shape, guide)[inner, inner])
    render = spoil_render(rng, render, guide)
    return blurry, trusted(blurry, render, share), clean


def random_target(rng):
    """A random anchor (alpha, gamma) between nearly none and the brightest the product allows."""
    share = 1 - rng.random() ** 2 if rng.random() < 0.7 else rng.random()
    alpha_end, gamma_end = np.exp(rng.uniform(np.log(3), np.log(15))), rng.uniform(0.4, 1.0)
    return 0.1 ** (1 - share) * alpha_end**share, gamma_end**share
