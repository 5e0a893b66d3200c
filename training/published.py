"""The published forward pass of 3D Gaussian splatting, written from the formulas alone.

Kerbl, Kopanas, Leimkuehler and Drettakis, "3D Gaussian Splatting for Real-Time Radiance Field Rendering", 2023:
Sigma = R S S^T R^T (eq. 6), Sigma' = J W Sigma W^T J^T (eq. 5) with the J of Zwicker et al., "EWA Splatting", 2002,
C = sum c_i alpha_i prod_{j<i} (1 - alpha_j) (eq. 3), and the constants that every viewer shares. No line comes from
another renderer or from the product. There are no tiles and no extents: every Gaussian before the near plane meets every
pixel of a row, in f64. Slow, and hard to get wrong; made to judge the product's renders with.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plyfile

# Added to the diagonal of every 2-D covariance, px^2.
LOW_PASS = 0.3
# Below it a splat is not blended at a pixel; above the other it is taken for the other.
ALPHA_LEAST, ALPHA_MOST = 1 / 255, 0.99
# Blending stops before the splat that would leave less light than this.
TRANSMITTANCE_LEAST = 1e-4
# J is taken at most this many half fields of view off the axis: the linear model runs away outside.
SLOPE_LIMIT = 1.3
# World units; what published viewers use.
NEAR = 0.2


@dataclass
class Scene:
    """What a PLY file says of its Gaussians: rotations w x y z, harmonics [n, coefficients, 3]."""

    means: np.ndarray
    rotations: np.ndarray
    log_scales: np.ndarray
    opacity_logits: np.ndarray
    harmonics: np.ndarray


@dataclass
class Camera:
    """A pinhole; x right, y down, z forward, px."""

    width: int
    height: int
    focal: tuple
    centre: tuple
    world_to_camera: np.ndarray


@dataclass
class Splats:
    """Gaussians on the image plane, nearest first: conics are the inverse covariances' a, b, c."""

    means: np.ndarray
    conics: np.ndarray
    opacities: np.ndarray
    colours: np.ndarray


def read_vertices(path):
    """The vertices of a PLY file that holds nothing else, as a structured array."""
    with Path(path).open("rb") as file:
        try:
            ply = plyfile.PlyData.read(file, mmap=False)
        except plyfile.PlyParseError as error:
            raise ValueError(f"{path}: {error}") from error
        if [element.name for element in ply.elements] != ["vertex"] or file.read(1):
            raise ValueError(f"{path}: not one list of vertices and nothing else")
    return ply["vertex"].data


def read_scene(path):
    """The Gaussians of a PLY file in the layout that the paper's authors introduced."""
    vertices = read_vertices(path)

    def columns(*names):
        missing = [name for name in names if name not in vertices.dtype.names]
        if missing:
            raise ValueError(f"{path}: no property {', '.join(missing)}")
        return np.stack([vertices[name].astype(np.float64) for name in names], -1)

    base = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    rest = sum(name.startswith("f_rest_") for name in vertices.dtype.names)
    if math.isqrt(1 + rest // 3) ** 2 != 1 + rest // 3 or rest % 3:
        raise ValueError(f"{path}: {rest} higher harmonics fit no degree")
    if rest:
        # All of red, then all of green, then all of blue.
        higher = columns(*(f"f_rest_{n}" for n in range(rest))).reshape(len(vertices), 3, rest // 3)
        base = np.concatenate([base, higher.transpose(0, 2, 1)], 1)
    return Scene(
        means=columns("x", "y", "z"),
        rotations=columns("rot_0", "rot_1", "rot_2", "rot_3"),
        log_scales=columns("scale_0", "scale_1", "scale_2"),
        opacity_logits=columns("opacity")[:, 0],
        harmonics=base,
    )


def read_cameras(path):
    """The cameras of a `cameras.json`, by name, in its order."""
    return {entry["name"]: camera(entry) for entry in json.loads(Path(path).read_text())}


def camera(entry):
    """A camera of one JSON object."""
    return Camera(
        width=entry["width"],
        height=entry["height"],
        focal=(entry["fx"], entry["fy"]),
        centre=(entry["cx"], entry["cy"]),
        world_to_camera=np.array(entry["world_to_camera"], np.float64),
    )


def unit(vectors):
    """Vectors [n, k] at length 1."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def rotation_matrices(rotations):
    """[n, 3, 3] of quaternions w x y z of any length: R v = q v q*."""
    w, x, y, z = unit(rotations).T
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def harmonic_basis(degree, directions):
    """Real spherical harmonics [n, (degree + 1)^2] with the Condon-Shortley phase, orders from -l to l.

    From the definition, K d^m P_l(z)/dz^m Re or Im (x + i y)^m, rather than from a table of polynomials.
    """
    x, y, z = directions.T
    columns = []
    for level in range(degree + 1):
        for order in range(-level, level + 1):
            m = abs(order)
            share = math.factorial(level - m) / math.factorial(level + m)
            norm = math.sqrt((2 * level + 1) / (4 * math.pi) * share)
            along = np.polynomial.Legendre.basis(level).deriv(m)(z)
            around = (x + 1j * y) ** m
            around = around.imag if order < 0 else around.real
            columns.append((-1) ** m * norm * (math.sqrt(2) if m else 1) * along * around)
    return np.stack(columns, 1)


def colours(scene, camera):
    """RGB of every Gaussian from where the camera stands: its harmonics, 0.5 more, at least 0."""
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    directions = unit(scene.means + rotation.T @ translation)
    basis = harmonic_basis(math.isqrt(scene.harmonics.shape[1]) - 1, directions)
    return np.maximum((basis[:, :, None] * scene.harmonics).sum(1) + 0.5, 0)


def flat_covariances(scene, camera, points, slope_limit=SLOPE_LIMIT):
    """[n, 2, 2] px^2: eq. 6, then eq. 5 with the Jacobian of the projection at the clamped point, then the low-pass."""
    spread = rotation_matrices(scene.rotations) * np.exp(scene.log_scales)[:, None]
    z = points[:, 2]
    jacobian = np.zeros((len(points), 2, 3))
    for axis, size in enumerate((camera.width, camera.height)):
        focal = camera.focal[axis]
        limit = slope_limit * size / (2 * focal)
        jacobian[:, axis, axis] = focal / z
        jacobian[:, axis, 2] = -focal * np.clip(points[:, axis] / z, -limit, limit) / z
    spread = jacobian @ camera.world_to_camera[:3, :3] @ spread
    return spread @ spread.transpose(0, 2, 1) + LOW_PASS * np.eye(2)


def project(scene, camera, near=NEAR):
    """The splats in front of the near plane."""
    points = scene.means @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    # Viewers sort in 32 bits, where a Gaussian and its clone may be equally far: then they stay in order.
    rotation, translation = (part.astype(np.float32) for part in (camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]))
    depths = (scene.means.astype(np.float32) @ rotation.T + translation)[:, 2]
    order = np.argsort(depths, kind="stable")
    order = order[points[order, 2] > near]
    scene = Scene(*(value[order] for value in vars(scene).values()))
    points = points[order]
    flat = flat_covariances(scene, camera, points)
    a, b, c = flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1]
    inverse = np.stack([c, -b, a], 1) / (a * c - b * b)[:, None]
    place = points[:, :2] / points[:, 2:] * camera.focal + camera.centre
    opacities = 1 / (1 + np.exp(-scene.opacity_logits))
    return Splats(place, inverse, opacities, colours(scene, camera))


def reaching(splats, y):
    """The splats that may be blended in a row: of the others even the greatest alpha on its line is below the cut."""
    a, b, c = splats.conics.T
    greatest = splats.opacities * np.exp(-0.5 * (c - b * b / a) * (y - splats.means[:, 1]) ** 2)
    kept = greatest >= 0.999 * ALPHA_LEAST
    return Splats(*(value[kept] for value in vars(splats).values()))


def blend_row(splats, y, width):
    """RGB [width, 3] of the row of pixels whose centres are at height `y`."""
    splats = reaching(splats, y)
    dx = np.arange(width)[:, None] + 0.5 - splats.means[:, 0]
    dy = y - splats.means[:, 1]
    a, b, c = splats.conics.T
    power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy
    alpha = np.minimum(splats.opacities * np.exp(power), ALPHA_MOST)
    alpha = np.where(alpha < ALPHA_LEAST, 0.0, alpha)
    left = np.cumprod(1 - alpha, 1)
    # What is left only falls, so the first splat that leaves too little also ends all behind it.
    alpha = np.where(left < TRANSMITTANCE_LEAST, 0.0, alpha)
    before = np.concatenate([np.ones((width, 1)), left[:, :-1]], 1)
    return (alpha * before) @ splats.colours


def render(scene, camera, near=NEAR):
    """RGB [height, width, 3] over black; not clamped above."""
    splats = project(scene, camera, near)
    return np.stack([blend_row(splats, y + 0.5, camera.width) for y in range(camera.height)])
