"""A network's place in the product: the images of its self-test, and its entry in the manifest."""

import hashlib
import json

import numpy as np

# px.
SIDE = 64


def self_test_images():
    """A view and a guide, f32 [6, SIDE, SIDE], by the formula of deblur/golden.rs."""
    place = np.arange(SIDE)
    along = np.broadcast_to(place.astype(np.float32) / np.float32(SIDE), (SIDE, SIDE))
    edge = np.where(place // 16 % 2 == (place // 16 % 2)[:, None], np.float32(0.2), np.float32(0))
    half, low = np.float32(0.5), np.float32(0.2)
    view = np.stack([low + half * along + edge, low + half * along.T + edge, np.float32(0.7) - half * along * along.T])
    return np.concatenate([view, view.transpose(0, 2, 1)])


def enter(manifest, path):
    """Write the file's size and checksum into the manifest entry that names it."""
    content = path.read_bytes()
    listing = manifest.read_text()
    entries = json.loads(listing)
    if not any(entry["file"] == path.name for entry in entries["models"]):
        raise SystemExit(f"{manifest} has no entry whose file is {path.name}: write one first")
    for entry in entries["models"]:
        if entry["file"] == path.name:
            for key, value in (("sha256", hashlib.sha256(content).hexdigest()), ("bytes", len(content))):
                # Textual, so that the manifest keeps its layout.
                start = listing.index(f'"{key}": ', listing.index(f'"file": "{path.name}"'))
                end = listing.index(",", start)
                listing = listing[:start] + f'"{key}": {json.dumps(value)}' + listing[end:]
    json.loads(listing)
    manifest.write_text(listing)
