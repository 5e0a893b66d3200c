"""The product's tone curve: clipped histogram equalisation of V, then an exponent.

One 256-entry table for all the images that are given (the product's `lut_scope = scene`).
Images are f32 arrays [H, W, 3], sRGB-encoded, 0..1.
"""

import numpy as np

# The meaning of alpha depends on this count: 1024 bins at alpha 10 give a mean V of 0.29, not 0.51.
BINS = 256


def value(image):
    """V of HSV, [H, W]."""
    return image.max(axis=2)


def histogram(images):
    """Pooled histogram of V * 255, each pixel shared linearly between its two bins, [256] f64."""
    counts = np.zeros(BINS)
    for image in images:
        position = np.clip(value(image).ravel(), 0.0, 1.0) * (BINS - 1)
        low = np.minimum(position.astype(np.int64), BINS - 2)
        share = position - low
        counts += np.bincount(low, 1.0 - share, BINS)
        counts += np.bincount(low + 1, share, BINS)
    return counts


def table(counts, alpha):
    """The equalisation's table [256] at clip limit `alpha`, or None for alpha = 0 (no equalisation)."""
    if alpha <= 0:
        return None
    total = counts.sum()
    limit = max(alpha * total / BINS, 1.0)
    excess = np.maximum(counts - limit, 0.0).sum()
    # One redistribution pass, not iterated: a bin may end slightly above the limit.
    clipped = np.minimum(counts, limit) + excess / BINS
    return np.cumsum(clipped) / total


def apply(image, lut, gamma):
    """Brighten one image with a table of `table` and the exponent; hue and saturation stay, f32 0..1."""
    if lut is not None:
        v = value(image)
        position = np.clip(v, 0.0, 1.0) * (BINS - 1)
        low = np.minimum(position.astype(np.int64), BINS - 2)
        share = position - low
        mapped = lut[low] * (1.0 - share) + lut[low + 1] * share
        image = image * (mapped / np.maximum(v, 1e-4))[..., None]
    return (np.clip(image, 0.0, 1.0) ** gamma).astype(np.float32)


def enhance(images, alpha, gamma):
    """E(I; alpha, gamma) with one table over all `images`."""
    lut = table(histogram(images), alpha)
    return [apply(image, lut, gamma) for image in images]


def automatic_target(images, mean=0.45):
    """(alpha_N, gamma_N) whose curve brings the pooled V to `mean` and is closest to a longer exposure that does."""
    counts = histogram(images)
    weights, v = counts / counts.sum(), np.arange(BINS) / (BINS - 1)
    light = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)

    def exposed(gain):
        x = gain * light
        return np.minimum(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055), 1.0)

    def bisect(low, high, brightness):
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if brightness(middle) <= mean else (low, middle)
        return low

    if weights @ v >= mean:
        return 0.1, 1.0
    wanted = exposed(np.exp(bisect(0.0, np.log(4096.0), lambda exponent: weights @ exposed(np.exp(exponent)))))
    best = None
    for alpha in np.geomspace(0.1, 15.0, 61):
        lut = table(counts, alpha)
        gamma = -bisect(-1.0, -0.3, lambda minus: weights @ lut ** -minus)
        missed = abs(weights @ lut**gamma - mean)
        score = (missed if missed >= 1e-3 else 0.0, weights @ (lut**gamma - wanted) ** 2)
        if best is None or score < best[0]:
            best = score, (float(alpha), float(gamma))
    return best[1]
