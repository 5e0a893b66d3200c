"""Golden values of the image metrics, from scikit-image and NumPy.

Run once with `pip install numpy scikit-image` (0.26.0 at the time) and
`python tests/golden/metrics.py > tests/golden/metrics.json`. The images are made by a formula
that `src/core/metrics/golden.rs` repeats, so no picture is stored.
"""

import json

import numpy as np
from skimage.metrics import peak_signal_noise_ratio, structural_similarity


def hashed(index):
    """A 32-bit integer hash (lowbias32) as a number in 0..1."""
    x = index.astype(np.uint64) & 0xFFFFFFFF
    x ^= x >> 16
    x = (x * 0x7FEB352D) & 0xFFFFFFFF
    x ^= x >> 15
    x = (x * 0x846CA68B) & 0xFFFFFFFF
    x ^= x >> 16
    return x.astype(np.float64) / 2.0**32


def picture(width, height):
    """[height, width, 3]: waves with hard stripes."""
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    waves = 0.45 + 0.25 * np.sin(0.21 * x + 0.9 * c) * np.cos(0.13 * y - 0.4 * c)
    return (waves + 0.15 * ((x // 9 + y // 7) % 2)).astype(np.float32)


def degraded(image, gain, offset, noise):
    height, width, _ = image.shape
    y, x, c = np.meshgrid(np.arange(height), np.arange(width), np.arange(3), indexing="ij")
    random = hashed((c * height + y) * width + x)
    return (gain * image.astype(np.float64) + offset + noise * (random - 0.5)).astype(np.float32)


def filtered(image, mask):
    luma = image.astype(np.float64) @ np.float32([0.299, 0.587, 0.114]).astype(np.float64)
    height, width = luma.shape
    return sum(mask[i][j] * luma[i : i + height - 2, j : j + width - 2] for i in range(3) for j in range(3))


def measure(width, height, gain, offset, noise):
    reference = picture(width, height)
    image = degraded(reference, gain, offset, noise)
    y, x = reference.astype(np.float64), np.clip(image.astype(np.float64), 0, 1)
    _, similarity = structural_similarity(
        y, x, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, full=True
    )
    fitted = np.empty_like(x)
    for c in range(3):
        a, b = np.linalg.lstsq(np.stack([x[..., c].ravel(), np.ones(x[..., c].size)], 1), y[..., c].ravel(), rcond=None)[0]
        fitted[..., c] = np.clip(a * x[..., c] + b, 0, 1)
    sigma = np.sqrt(np.pi / 2) / 6 * np.abs(filtered(image, [[1, -2, 1], [-2, 4, -2], [1, -2, 1]])).mean()
    laplacian = filtered(image, [[0, 1, 0], [1, -4, 1], [0, 1, 0]])
    return {
        "size": [width, height],
        "change": [gain, offset, noise],
        "psnr": peak_signal_noise_ratio(y, x, data_range=1),
        "psnr_colour_corrected": peak_signal_noise_ratio(y, fitted, data_range=1),
        "ssim": similarity[5:-5, 5:-5].mean(),
        "noise_sigma": sigma,
        "sharpness": 255**2 * max(0.0, laplacian.var() - 20 * sigma**2),
        "mean_v": x.max(axis=2).mean(),
        "clipped_share": (image.max(axis=2) >= np.float32(254.5 / 255)).mean(),
    }


CASES = [(96, 64, 1.0, 0.0, 0.1), (75, 53, 0.6, 0.1, 0.04), (48, 80, 1.5, 0.05, 0.3), (31, 29, 1.0, 0.001, 0.002)]
print(json.dumps([measure(*case) for case in CASES], indent=1))
