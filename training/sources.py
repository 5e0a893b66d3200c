"""Sharp images to learn from: photographs that ship inside packages, and procedural scenes.

    python sources.py photographs

copies the photographs, for a machine that lacks the packages; FLED_PHOTOGRAPHS names the folder there.
"""

import importlib.util
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import scipy.ndimage as nd
from PIL import Image, ImageDraw, ImageFont


def chosen(otherwise):
    """The folder that FLED_PHOTOGRAPHS names, else what `otherwise` says."""
    return Path(os.environ["FLED_PHOTOGRAPHS"]) if "FLED_PHOTOGRAPHS" in os.environ else otherwise()


def folder(package, *below):
    """Where a Python package keeps its photographs."""
    found = importlib.util.find_spec(package)
    if found is None:
        raise SystemExit(f"{package} is missing: install requirements.txt, or set FLED_PHOTOGRAPHS")
    return Path(found.origin).parent.joinpath(*below)


SKIMAGE = chosen(lambda: folder("skimage", "data"))
SKLEARN = chosen(lambda: folder("sklearn", "datasets", "images"))
# Debian's packages lomiri-wallpapers-16.04, libjxl-testdata and endless-sky-high-dpi.
LOMIRI = chosen(lambda: Path("/usr/share/backgrounds"))
JXL = chosen(lambda: Path("/usr/share/libjxl-testdata/jxl"))
JXL_FLOWER = chosen(lambda: JXL / "flower")
JXL_500 = chosen(lambda: JXL.parent / "external/wesaturate/500px")
ENDLESS_SKY = chosen(lambda: Path("/usr/share/games/endless-sky/plugins/endless-sky-high-dpi/images/land"))

# Of its landscapes those in the public domain that are not mostly sky or haze; every kind has its numbers.
LANDSCAPES = {
    "badlands": (0, 1, 2, 4, 6, 7), "beach": (1, 2, 3, 4, 6), "canyon": (0, 2, 4, 5, 7, "01", "04", "05"), "city": (0, 8),
    "desert": (0, 2, 4, 5), "fields": (1, 3, 4, 7, 8), "fog": (3,), "forest": (1, 3, 4, 5), "hills": (0, 1, 2),
    "lava": (0, 1, 2, 3, 6), "loc": (1,), "mountain": (2, 3, 5, 8, 9), "sea": (0, 1, 3, 5, 8), "snow": (0, 1, 4, 6, 7, 8, 9, 10),
    "station": (3,), "valley": (1, 3, 5, 8), "water": (0, 3, 5, 8, 9),
}


def landscape(name):
    """The file of one of the landscapes."""
    return ENDLESS_SKY / f"{name}@2x.jpg"


TRAINING_LANDSCAPES = [landscape(f"{kind}{number}") for kind, numbers in LANDSCAPES.items() for number in numbers]

TRAINING = [
    SKIMAGE / name
    for name in (
        "astronaut.png", "coffee.png", "motorcycle_left.png", "motorcycle_right.png", "camera.png", "brick.png",
        "gravel.png", "grass.png", "ihc.png", "retina.jpg", "hubble_deep_field.jpg", "moon.png", "page.png",
        "text.png",
    )
] + [SKLEARN / "flower.jpg"] + [
    LOMIRI / f"{name}.jpg"
    for name in (
        "Picture_0B_by_freespace", "Picture_1A_by_freespace", "Wine_by_Jakkub_Mede", "aitzgorri_by_Aitzol_Berasategi",
        "friends_by_Aitzol_Berasategi", "life_by_Aitzol_Berasategi", "picosdeeuropa_by_Aitzol_Berasategi",
        "seeding_by_Clements_Engelhardt", "sunset_by_Aitzol_Berasategi",
    )
] + [JXL / "hdr_room.png", JXL_FLOWER / "flower.png"] + [
    JXL_500 / f"{name}_srgb8.png" for name in ("cvo9xd_keong_macan", "tmshre_riaphotographs", "u76c0g_bliznaca")
] + TRAINING_LANDSCAPES

# Never seen in training, in no form: no other file shows the same subject. The gates are of these.
HELD_OUT = [SKLEARN / "china.jpg", SKIMAGE / "chelsea.png", SKIMAGE / "rocket.jpg", SKIMAGE / "coins.png"]

# Nor these, of which no trained one is taken from near the same place: four photographs are few.
HELD_OUT_LANDSCAPES = [
    landscape(name)
    for name in (
        "badlands3", "beach0", "canyon9", "city10", "city11", "city4", "dune4", "fields0", "fields5",
        "forest2", "fog4", "loc0", "loc2", "mountain7", "mountain1", "station0", "station2", "station4", "valley6",
        "valley9", "water2",
    )
]

# hdr_room.png is in HLG and taken for sRGB: to the network a room of another contrast.
# How often each training photograph is drawn; the others once. Scenes with depth, objects and people count more, the
# landscapes together about as much as all the others.
WEIGHTS = {
    "astronaut": 4, "coffee": 3, "motorcycle_left": 4, "motorcycle_right": 4, "flower": 2, "camera": 3, "hdr_room": 4,
    "Picture_0B_by_freespace": 2, "Picture_1A_by_freespace": 3, "Wine_by_Jakkub_Mede": 3, "aitzgorri_by_Aitzol_Berasategi": 3,
    "friends_by_Aitzol_Berasategi": 4, "life_by_Aitzol_Berasategi": 4, "picosdeeuropa_by_Aitzol_Berasategi": 3,
}

# Mean step from pixel to pixel below which a crop is drawn once more: a sky teaches little.
FLAT = 0.008

# Larger photographs are reduced to this side, px: pixel by pixel they are softer than what the product is given.
SIDE = 1280
# And those held out to the size of the gates' photographs.
HELD_OUT_SIDE = 640


def load(path):
    """An 8-bit RGB array [H, W, 3]."""
    return np.asarray(Image.open(path).convert("RGB"))


def photograph(path, side=SIDE):
    """A photograph, 8-bit RGB [H, W, 3], neither side above `side`."""
    if not path.exists():
        raise SystemExit(f"{path} is missing: install what README.md says, or fill the folder that FLED_PHOTOGRAPHS names again")
    image = Image.open(path).convert("RGB")
    image.thumbnail((side, side), Image.LANCZOS)
    return np.asarray(image)


def photographs():
    """The training photographs and their weights."""
    weights = np.array([WEIGHTS.get(path.stem, 1) for path in TRAINING], float)
    return [photograph(path) for path in TRAINING], weights / weights.sum()


def fractal(rng, height, width, channels=1):
    """Noise with a power-law spectrum, 0..1, [H, W, channels]."""
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    radius = np.hypot(fy * rng.uniform(0.5, 2), fx)
    radius[0, 0] = 1
    amplitude = radius ** -rng.uniform(0.6, 2.0)
    amplitude[0, 0] = 0
    planes = []
    for _ in range(channels):
        phase = np.exp(2j * np.pi * rng.random(amplitude.shape))
        plane = np.fft.irfft2(amplitude * phase, (height, width))
        planes.append((plane - plane.min()) / max(np.ptp(plane), 1e-9))
    return np.stack(planes, -1).astype(np.float32)


def paint_colour(rng):
    """A random colour, most often a muted one, [3]."""
    level, chroma = rng.random() ** rng.uniform(0.6, 2), rng.random() ** 1.5
    return np.clip(level + (rng.random(3) - 0.5) * chroma, 0, 1)


def texture(rng, height, width, photos):
    """One surface: flat, shaded, fractal, striped, chequered, or a piece of a photograph; f32 [H, W, 3]."""
    first, second = paint_colour(rng), paint_colour(rng)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    angle, period = rng.uniform(0, np.pi), np.exp(rng.uniform(np.log(3), np.log(40)))
    along = x * np.cos(angle) + y * np.sin(angle)
    across = y * np.cos(angle) - x * np.sin(angle)
    kind = rng.integers(0, 7)
    if kind == 0:
        mix = np.zeros((height, width))
    elif kind == 1:
        mix = along / max(height, width) * 0.7
    elif kind == 2:
        mix = fractal(rng, height, width)[..., 0]
    elif kind == 3:
        mix = 0.5 + 0.5 * np.clip(np.sin(along * 2 * np.pi / period) * rng.uniform(1, 6), -1, 1)
    elif kind == 4:
        mix = 0.5 + 0.5 * np.clip(np.sin(along * 2 * np.pi / period) * np.sin(across * 2 * np.pi / period) * 4, -1, 1)
    elif kind == 5:
        return piece(rng, height, width, photos)
    else:
        return fractal(rng, height, width, 3) * (0.3 + first) * 0.8
    return (first + (second - first) * mix[..., None]).astype(np.float32)


def piece(rng, height, width, photos):
    """A random piece of a training photograph, 0..1."""
    photo = photos[rng.integers(len(photos))]
    top = rng.integers(max(photo.shape[0] - height, 0) + 1)
    left = rng.integers(max(photo.shape[1] - width, 0) + 1)
    part = photo[top : top + height, left : left + width].astype(np.float32) / 255
    pad = ((0, height - part.shape[0]), (0, width - part.shape[1]), (0, 0))
    return np.pad(part, pad, "symmetric")


def outline(rng, size):
    """A filled random shape, soft-edged mask [size, size]: ellipse, polygon, bar or words."""
    canvas = Image.new("L", (size * 2, size * 2))
    draw = ImageDraw.Draw(canvas)
    middle, reach = size, size * 0.95
    kind = rng.integers(0, 8)
    if kind < 2:
        half = reach * rng.uniform(0.35, 1, 2)
        draw.ellipse([*(middle - half), *(middle + half)], fill=255)
    elif kind < 5:
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
        radii = reach * rng.uniform(0.4, 1, len(angles))
        points = np.stack([middle + radii * np.cos(angles), middle + radii * np.sin(angles)], 1)
        draw.polygon([tuple(point) for point in points], fill=255)
    elif kind < 7:
        half = reach * np.array([rng.uniform(0.6, 0.9), rng.uniform(0.03, 0.4)])
        draw.rectangle([*(middle - half), *(middle + half)], fill=255)
    else:
        letters = "".join(rng.choice(list("abcdefghijklmnopqrstuvwxyzABCDEFGHKLMNRSTW0123456789 "), 60))
        height = int(np.exp(rng.uniform(np.log(14), np.log(60))))
        font = ImageFont.load_default(height)
        for row in range(0, 2 * size, int(height * 1.3)):
            draw.text((0, row), letters[row % 40 :], fill=255, font=font)
    canvas = canvas.rotate(rng.uniform(0, 360), Image.BILINEAR)
    return np.asarray(canvas.resize((size, size), Image.BOX), np.float32) / 255


def procedural(rng, size, photos):
    """Surfaces occluding one another, sizes by a power law, with shading and small lights, u8 [size, size, 3]."""
    scene = texture(rng, size, size, photos)
    for _ in range(int(rng.integers(40, 200))):
        extent = int(min(10 / max(rng.random(), 0.03), size * 0.6) + 6)
        top, left = rng.integers(-extent // 2, size - extent // 2, 2)
        mask = outline(rng, extent)[..., None]
        if rng.random() < 0.25:
            mask = mask * rng.uniform(0.3, 1)
        paint = texture(rng, extent, extent, photos)
        y0, x0, y1, x1 = max(top, 0), max(left, 0), min(top + extent, size), min(left + extent, size)
        inside = (slice(y0 - top, y1 - top), slice(x0 - left, x1 - left))
        region = scene[y0:y1, x0:x1]
        region += (paint[inside] - region) * mask[inside]
    if rng.random() < 0.5:
        scene *= 0.4 + 0.9 * fractal(rng, size, size) ** rng.uniform(0.5, 1.5)
    if rng.random() < 0.4:
        add_lights(rng, scene)
    if rng.random() < 0.5:
        scene = nd.gaussian_filter(scene, (rng.uniform(0.2, 0.6),) * 2 + (0,))
    return np.rint(np.clip(scene, 0, 1) * 255).astype(np.uint8)


def add_lights(rng, scene):
    """Small bright points: under shake they draw the path of the camera."""
    size = scene.shape[0]
    for _ in range(int(rng.integers(1, 15))):
        y, x = rng.integers(0, size - 6, 2)
        extent = int(rng.integers(1, 6))
        scene[y : y + extent, x : x + extent] = 0.8 + 0.2 * rng.random(3)


class Sources:
    """Draws sharp images; procedural scenes are kept in a pool that is renewed one by one."""

    def __init__(self, rng, pool=48, size=448):
        self.photos, self.weights = photographs()
        self.size = size
        self.pool_size = pool
        self.pool = [procedural(rng, size, self.photos) for _ in range(8)]

    def draw(self, rng, side):
        """A sharp crop f32 [side, side, 3], augmented.

        Two fifths are enlarged, and so no sharper than a lens that is a little out of focus: a network that has only seen crisp truths
        sharpens the photographs of every other lens beyond theirs.
        """
        if rng.random() < 0.6:
            image = self.photos[rng.choice(len(self.photos), p=self.weights)]
            low, high = 0.55, 1.8
        else:
            if rng.random() < 0.15:
                self.renew(rng)
            image = self.pool[rng.integers(len(self.pool))]
            low, high = 0.75, 1.6
        scale = np.exp(rng.uniform(np.log(low), 0) if rng.random() < 0.6 else rng.uniform(0, np.log(high)))
        part = crop(rng, image, side, scale)
        if max(np.abs(np.diff(part, axis=axis)).mean() for axis in (0, 1)) < FLAT:
            part = crop(rng, image, side, scale)
        return augment(rng, part)

    def renew(self, rng):
        """Add a fresh procedural scene, in place of a random one when the pool is full."""
        scene = procedural(rng, self.size, self.photos)
        if len(self.pool) < self.pool_size:
            self.pool.append(scene)
        else:
            self.pool[rng.integers(len(self.pool))] = scene


def crop(rng, image, side, scale):
    """A square of `side` pixels from the image at `scale`; reflected where the image is too small."""
    wanted = int(round(side / scale))
    height, width = min(wanted, image.shape[0]), min(wanted, image.shape[1])
    top, left = rng.integers(image.shape[0] - height + 1), rng.integers(image.shape[1] - width + 1)
    part = image[top : top + height, left : left + width]
    part = np.pad(part, ((0, wanted - height), (0, wanted - width), (0, 0)), "symmetric")
    if wanted != side:
        part = np.asarray(Image.fromarray(part).resize((side, side), Image.LANCZOS))
    return part.astype(np.float32) / 255


def augment(rng, image):
    """Flips, quarter turns, channel order, tint and contrast."""
    if rng.random() < 0.5:
        image = image[:, ::-1]
    image = np.rot90(image, rng.integers(4))
    if rng.random() < 0.3:
        image = image[..., rng.permutation(3)]
    if rng.random() < 0.7:
        image = image ** np.float32(np.exp(rng.normal() * 0.25)) * (1 - 0.4 * rng.random(3, np.float32) ** 2)
    return np.ascontiguousarray(image, np.float32)


if __name__ == "__main__":
    target = Path(sys.argv[1])
    target.mkdir(parents=True, exist_ok=True)
    for path in TRAINING + HELD_OUT + HELD_OUT_LANDSCAPES:
        shutil.copy(path, target)
