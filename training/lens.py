"""The bend of a lens taken out of a photograph, as the product does it (poses/lens.rs)."""

import numpy as np
import scipy.ndimage as nd


def undistorted(image, lens, pinhole):
    """An image [H, W, 3] without the bend of its lens, as `pinhole` sees it."""
    bend, lens = lens["distortion"], lens["intrinsics"]
    # COLMAP is asked for one coefficient; more would be a change of the product.
    k1, *others = bend.get("radial", [0.0])
    if bend["model"] not in ("none", "perspective") or any(others) or any(bend.get("tangential", [])):
        raise SystemExit(f"this lens is not understood: {bend}")
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32) + 0.5
    x, y = (x - pinhole["cx"]) / pinhole["fx"], (y - pinhole["cy"]) / pinhole["fy"]
    scale = 1 + k1 * (x * x + y * y)
    place = [y * scale * lens["fy"] + lens["cy"] - 0.5, x * scale * lens["fx"] + lens["cx"] - 0.5]
    return np.stack([nd.map_coordinates(image[..., c], place, order=1, mode="nearest") for c in range(3)], -1)
