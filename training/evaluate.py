"""PSNR and SSIM tables of ONNX deblurring networks, on held-out photographs and on captures with ground truth.

    python evaluate.py ../models/small-u2w16.onnx other.onnx --captures DIR --crops crops
    python evaluate.py ../models/small-u2w16.onnx --gates        # fails when a network is not good enough to be shipped
    python evaluate.py ../models/small-u2w16.onnx --told         # beside a filter that is told the shake
"""

import argparse
from pathlib import Path

import numpy as np
import onnxruntime
import scipy.fft
from PIL import Image
from skimage.metrics import structural_similarity

import degrade
import sources
import tone_curve
from degrade import Blur, Exposure, Guide, MARGIN

ISO = 800
# The guide of every case: what a first round's renders look like, by the same simulation that training uses.
GUIDE = dict(sigma=0.7, drift=0.015, warp=0.5, grain=0.01)


def case(name, extent, light=1.0, iso=ISO, target="auto"):
    return dict(name=name, extent=extent, light=light, iso=iso, target=target)


CASES = [
    case("sharp and clean", 0, iso=0, target=None),
    case("blur 8 px, clean", 8, iso=0, target=None),
    case("blur 14 px, clean", 14, iso=0, target=None),
    case("noise only, brightened x10", 0, 0.1),
    case("paper-like: blur 8, dark x10, noise", 8, 0.1),
    case("blur 14, dark x10, noise", 14, 0.1),
    case("round-1 level, blur 8, noise", 8, 0.1, target=(1.0, 0.894)),
    case("blur 8, dark x3, noise", 8, 0.3),
    case("blur 8, dark x30, noise", 8, 0.03),
    case("blur 8, dark x10, less noise (ISO 200)", 8, 0.1, 200),
    case("blur 8, dark x10, more noise (ISO 3200)", 8, 0.1, 3200),
]


class Model:
    """An ONNX network of 6 or 3 channels; pads by reflection to multiples of 16 and crops back.

    One of 3 is fed the guide in the view's place, as in the product.
    """

    def __init__(self, path):
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self.input = self.session.get_inputs()[0]

    def __call__(self, blurry, guide=None):
        height, width = blurry.shape[:2]
        guide = blurry if guide is None else guide
        planes = [guide] if self.input.shape[1] == 3 else [blurry, guide]
        pad = ((0, -height % 16), (0, -width % 16), (0, 0))
        pair = np.pad(np.concatenate(planes, 2), pad, "reflect").transpose(2, 0, 1)[None]
        output = self.session.run(None, {self.input.name: np.ascontiguousarray(pair, np.float32)})[0][0]
        return np.clip(output.transpose(1, 2, 0)[:height, :width], 0, 1)


def psnr(image, clean):
    return float(-10 * np.log10(max(np.mean((np.clip(image, 0, 1) - clean) ** 2), 1e-10)))


def scores(image, clean):
    """PSNR, dB, and SSIM with the usual window of 11 px, the mean over the channels."""
    window = dict(gaussian_weights=True, sigma=1.5, use_sample_covariance=False)
    ssim = structural_similarity(np.clip(image, 0, 1), clean, channel_axis=2, data_range=1, **window)
    return psnr(image, clean), float(ssim)


def colour_fitted(image, truth):
    """The image under the affine map a channel that brings it nearest to the truth."""
    fitted = np.empty_like(image)
    for channel in range(3):
        basis = np.stack([image[..., channel].ravel(), np.ones(image[..., 0].size)], 1)
        fit = np.linalg.lstsq(basis, truth[..., channel].ravel(), rcond=None)[0]
        fitted[..., channel] = image[..., channel] * fit[0] + fit[1]
    return fitted


def random_shake(rng, extent):
    """The blur of an example of this extent, px."""
    return Blur([degrade.shake_kernel(rng, extent * rng.uniform(0.8, 1.2))] if extent else [])


def example(path, description, seed, share=1.0):
    """Blurry, guide (with a share of its render's detail) and clean of one held-out photograph in one case."""
    rng = np.random.default_rng(seed)
    photo = sources.photograph(path, sources.HELD_OUT_SIDE).astype(np.float32) / 255
    sharp = np.pad(photo, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), "reflect")
    extent = description["extent"]
    blur = random_shake(rng, extent)
    shot, read = degrade.sensor(description["iso"]) if description["iso"] else (0.0, 0.0)
    exposure = Exposure(description["light"], shot, read)
    target = description["target"]
    if target == "auto":
        dark = degrade.expose(rng, degrade.decode(photo), exposure)
        target = tone_curve.automatic_target([dark])
    guide = Guide(extent=max(extent * 0.5, 2), **GUIDE)
    return degrade.pair(rng, degrade.decode(sharp), blur, exposure, target, guide, share)


def held_out_table(models, photographs, repeats, crops):
    """Rows of (case, input, guide alone, then single and guided of every model), each PSNR, dB, and SSIM: the means over
    `photographs`, each with `repeats` kernels and noises.
    """
    rows = []
    for number, description in enumerate(CASES):
        values = []
        for index, path in enumerate(photographs):
            for repeat in range(repeats):
                seed = [number, index, repeat]
                blurry, guide, clean = example(path, description, seed)
                fed = example(path, description, seed, degrade.SHARE)[1]
                outputs = [blurry, guide]
                for model in models:
                    outputs += [model(blurry), model(blurry, fed)]
                values.append([scores(output, clean) for output in outputs])
                if crops and repeat == 0:
                    save_crop(crops / f"{path.stem}-{number}.png", [*outputs, clean])
        rows.append((description["name"], *np.mean(values, 0)))
    return rows


def told_rows(models, repeats):
    """Rows of (photograph, input, a Wiener filter told the kernel, then single of every model), dB, in the second case.

    The filter has the best of five noise levels for each image: what could be had, not what can be had.
    """
    number, description = 1, CASES[1]
    rows = []
    for index, path in enumerate(sources.HELD_OUT):
        for repeat in range(repeats):
            seed = [number, index, repeat]
            blurry, _, clean = example(path, description, seed)
            kernel = random_shake(np.random.default_rng(seed), description["extent"]).kernels[0]
            light = degrade.decode(np.pad(blurry, ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0)), "reflect"))
            point = np.zeros((*light.shape[:2], 1), np.float32)
            point[0, 0] = 1
            transfer = degrade.spectrum(degrade.convolve(degrade.spectrum(point), kernel, light.shape[:2]))
            inner = slice(MARGIN, -MARGIN)
            filtered = [
                degrade.spectrum(light) * np.conj(transfer) / (np.abs(transfer) ** 2 + noise)
                for noise in (1e-4, 1e-3, 3e-3, 1e-2, 3e-2)
            ]
            restored = [scipy.fft.irfft2(f, light.shape[:2], axes=(0, 1))[inner, inner] for f in filtered]
            told = max(psnr(degrade.encode(image), clean) for image in restored)
            rows.append((f"{path.stem}, {repeat}", psnr(blurry, clean), told, *(psnr(model(blurry), clean) for model in models)))
    return rows


def gates(rows):
    """(what is asked, dB asked, dB there of every network) in the rows of `held_out_table`."""
    by_case = {row[0]: [decibels for decibels, _ in row[1:]] for row in rows}
    sharp, clean = by_case["sharp and clean"], by_case["blur 8 px, clean"]
    paper = by_case["paper-like: blur 8, dark x10, noise"]
    single, guided = slice(2, None, 2), slice(3, None, 2)
    return [
        ("a sharp, clean image comes back at", 40.0, *sharp[single]),
        ("blur 8 px, clean: single above the input by", 1.5, *(there - clean[0] for there in clean[single])),
        ("paper-like: single above the input by", 3.0, *(there - paper[0] for there in paper[single])),
        ("paper-like: guided above the guide by", 1.0, *(there - paper[1] for there in paper[guided])),
    ]


def save_crop(path, images, side=192):
    """The middles of the images side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    top, left = (images[0].shape[0] - side) // 2, (images[0].shape[1] - side) // 2
    strip = np.concatenate([np.clip(image[top : top + side, left : left + side], 0, 1) for image in images], 1)
    Image.fromarray(np.rint(strip * 255).astype(np.uint8)).save(path)


def capture_rows(models, folder, crops):
    """Rows of (capture, view count, input, then single of every model), each PSNR, dB, and SSIM after the colour fit."""
    names = sorted(path.name for path in (folder / "images").iterdir())
    dark = [sources.load(folder / "images" / name).astype(np.float32) / 255 for name in names]
    truth = [sources.load(folder / "gt" / name).astype(np.float32) / 255 for name in names]
    bright = tone_curve.enhance(dark, *tone_curve.automatic_target(dark))
    values = []
    for view, (blurry, sharp) in enumerate(zip(bright, truth)):
        outputs = [colour_fitted(image, sharp) for image in [blurry, *[model(blurry) for model in models]]]
        values.append([scores(output, sharp) for output in outputs])
        if crops and view in (0, len(names) // 2):
            save_crop(crops / f"{folder.name}-{view}.png", [*outputs, sharp])
    return (folder.name, len(names), *np.mean(values, 0))


def text(cell):
    """A table's cell: a number that is not whole with two decimals, PSNR and SSIM as 30.12 / 0.912."""
    if isinstance(cell, np.ndarray):
        return f"{cell[0]:.2f} / {cell[1]:.3f}"
    return f"{cell:.2f}" if isinstance(cell, float) else str(cell)


def table(header, rows):
    """A Markdown table."""
    lines = [list(header), ["---"] * len(header), *([text(cell) for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, nargs="+")
    parser.add_argument("--captures", type=Path, help="folder of captures with images/ and gt/")
    parser.add_argument("--repeats", type=int, default=3, help="kernels and noise per photograph and case")
    parser.add_argument("--landscapes", action="store_true", help="the table of the held-out landscapes, not of the gates' four photographs")
    parser.add_argument("--gates", action="store_true", help="judge the networks by the table")
    parser.add_argument("--told", action="store_true", help="only this: blur of 8 px, clean, beside a filter that is told the kernel")
    parser.add_argument("--crops", type=Path, help="write crops of the results here")
    options = parser.parse_args()
    if options.landscapes and (options.gates or options.told):
        parser.error("the gates and --told are of the four photographs")
    models = [Model(path) for path in options.models]
    names = [path.stem for path in options.models]
    if options.told:
        print(table(["photograph", "input", "told the kernel", *names], told_rows(models, options.repeats)))
        return
    header = ["case", "input", "guide alone"] + [f"{name} {kind}" for name in names for kind in ("single", "guided")]
    photographs = sources.HELD_OUT_LANDSCAPES if options.landscapes else sources.HELD_OUT
    rows = held_out_table(models, photographs, options.repeats, options.crops)
    print(table(header, rows), flush=True)
    if options.captures:
        folders = sorted(path for path in options.captures.iterdir() if (path / "gt").is_dir())
        print("\n" + table(["capture", "views", "input", *names], [capture_rows(models, f, options.crops) for f in folders]))
    if options.gates:
        verdicts = gates(rows)
        print("\n" + table(["gate", "asked, dB", *names], verdicts))
        if not all(value >= asked for _, asked, *there in verdicts for value in there):
            raise SystemExit("not every gate is passed")


if __name__ == "__main__":
    main()
