"""An endless, seeded stream of training patches."""

from pathlib import Path

import numpy as np
import torch
from torch.utils.data import IterableDataset

import degrade
import sources

# A shake is found from as much as one sees: the same network trained on 128 px for as long undid less of it (../docs/decisions/networks.md).
PATCH = 256
# Rooms' renders are smaller: four places of one, which share blur, exposure and tone curve, make a patch.
PLACE = PATCH // 2
# Making a patch costs as much as training on it: each is shown several times, far apart and turned differently.
USES = 3
# Share of the scenes whose guide is a render by the product itself (`renders.py`), where there are such.
REAL_GUIDES = 0.2
# Share of the other scenes with enough light, from which deblurring is learnt: under noise a network learns to average.
CLEAN = 0.65
# Deviation of the colours of real renders, which the loop carries from one brightness to the next by a curve that it finds.
DRIFT = 0.015


class Patches(IterableDataset):
    """Yields (input [6, P, P], clean [3, P, P]); `seed` and `start` fix the stream.

    `renders` is a folder that renders.py has filled, or None: all guides are then simulated. `buffer` patches are mixed: many
    batches, so that one batch hardly holds a patch twice.
    """

    def __init__(self, seed, start=0, renders=None, buffer=60):
        self.seed, self.buffer = [seed, start], buffer
        self.views = sorted(Path(renders).glob("*.render.npy")) if renders else []
        if renders and not self.views:
            raise FileNotFoundError(f"{renders} has no views; make them by renders.py")

    def __iter__(self):
        worker = torch.utils.data.get_worker_info()
        torch.set_num_threads(1)
        rng = np.random.default_rng([*self.seed, worker.id if worker else 0])
        supply = sources.Sources(rng)
        buffer = []
        while True:
            real = self.views and rng.random() < REAL_GUIDES
            buffer.append((view_patch(rng, self.views) if real else scene_patch(rng, supply), USES))
            while len(buffer) > self.buffer:
                place = rng.integers(len(buffer))
                planes, uses = buffer[place]
                if uses > 1:
                    buffer[place] = (turned(rng, planes), uses - 1)
                else:
                    buffer[place] = buffer[-1]
                    buffer.pop()
                stacked = torch.from_numpy(planes.astype(np.float32))
                yield stacked[:6], stacked[6:]


def turned(rng, planes):
    """A flip, transposition or both of [C, P, P], never the patch itself."""
    kind = rng.integers(1, 8)
    if kind & 1:
        planes = planes[:, ::-1]
    if kind & 2:
        planes = planes[:, :, ::-1]
    if kind & 4:
        planes = planes.swapaxes(1, 2)
    return planes


def scene_patch(rng, supply):
    """One degraded scene, f16 [9, P, P]: blurry, guide, clean."""
    light = degrade.decode(supply.draw(rng, PATCH + 2 * degrade.MARGIN))
    if rng.random() < 0.7:
        # Highlights beyond what the sensor holds: blur spreads them before it clips them.
        light *= 1.25
    clean = rng.random() < CLEAN
    blur = degrade.clean_blur(rng) if clean else degrade.random_blur(rng, light.shape[:2])
    if clean:
        exposure = degrade.clean_exposure(rng)
        target = degrade.random_target(rng) if rng.random() < 0.15 else None
    else:
        exposure = degrade.random_exposure(rng)
        target = degrade.random_target(rng) if rng.random() < 0.95 else None
    # No guide is the harder case, so it comes more often.
    guide = degrade.random_guide(rng) if rng.random() < (0.22 if clean else 0.4) else None
    stacked = np.concatenate(degrade.pair(rng, light, blur, exposure, target, guide), 2)
    return np.moveaxis(stacked, 2, 0).astype(np.float16)


def view_patch(rng, views):
    """Four places of one view that the product has rendered, side by side, f16 [9, P, P]: blurry, guide, clean.

    The guide is the view with the render's detail where the two agree.
    """
    view = np.load(views[rng.integers(len(views))], mmap_mode="r")
    gain, offset = 1 + rng.normal(size=3) * DRIFT, rng.normal(size=3) * DRIFT / 2
    # Rooms' renders are seldom too crisp by themselves.
    crispness = degrade.random_crispness(rng)
    # Two fifths are enlarged, because a room is sharper than most photographs are.
    side = round(PLACE / rng.uniform(1.1, 1.9)) if rng.random() < 0.4 else PLACE
    places, copied = [], rng.random() < 0.3
    for _ in range(4):
        y, x = (rng.integers(length - side + 1) for length in view.shape[1:])
        patch = np.array(view[:, y : y + side, x : x + side], np.float32)
        if side != PLACE:
            whole = torch.from_numpy(patch)[None]
            patch = torch.nn.functional.interpolate(whole, (PLACE, PLACE), mode="bicubic").clamp(0, 1)[0].numpy()
        if copied:
            patch[3:6] = patch[:3]
        else:
            blurry, render = np.moveaxis(patch[:3], 0, 2), np.moveaxis(patch[3:6], 0, 2)
            render = degrade.crisper(rng, render, crispness) * gain + offset
            guide = degrade.trusted(blurry, np.clip(render, 0, 1).astype(np.float32))
            patch[3:6] = np.moveaxis(guide, 2, 0)
        places.append(patch.astype(np.float16))
    rows = [np.concatenate(places[first : first + 2], 2) for first in (0, 2)]
    return turned(rng, np.concatenate(rows, 1))
