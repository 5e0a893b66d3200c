"""What other programs read in an exported scene, compared with scene.ply."""

import json

import numpy as np
import plyfile

Y00 = 0.28209479177387814
# The harmonics that are odd in y and z together: they change sign in a world with y up.
ODD = [0, 1, 3, 6, 8, 10, 11, 13]


def covariances(rotations, scales):
    """Covariances xx, xy, xz, yy, yz, zz [N, 6] of quaternions w x y z [N, 4] and axes [N, 3]."""
    w, x, y, z = (rotations / np.linalg.norm(rotations, axis=1, keepdims=True)).T
    rows = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    axes = np.moveaxis(np.array(rows), 2, 0) * scales[:, None, :]
    matrices = axes @ np.swapaxes(axes, 1, 2)
    return matrices[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]


def of_ply(path):
    """The Gaussians of a PLY file in the layout of 3DGS."""
    vertices = plyfile.PlyData.read(path)["vertex"].data

    def columns(*names):
        return np.stack([vertices[name].astype(float) for name in names], axis=1)

    rest = sum(name.startswith("f_rest_") for name in vertices.dtype.names)
    higher = columns(*(f"f_rest_{n}" for n in range(rest))) if rest else np.zeros((len(vertices), 0))
    return {
        "position": columns("x", "y", "z"),
        "covariance": covariances(columns("rot_0", "rot_1", "rot_2", "rot_3"), np.exp(columns("scale_0", "scale_1", "scale_2"))),
        "colour": 0.5 + Y00 * columns("f_dc_0", "f_dc_1", "f_dc_2"),
        "opacity": 1 / (1 + np.exp(-columns("opacity"))),
        "harmonics": np.swapaxes(higher.reshape(len(vertices), 3, rest // 3), 1, 2),
    }


def of_three(text):
    """The Gaussians that peers.mjs prints, and the matrix of their node."""
    read = json.loads(text)
    count = read["count"]
    colours = np.array(read["colour"]).reshape(count, 4) / 255
    bands = [np.array(band["bytes"]).reshape(count, band["row"])[:, :3 * (2 * degree + 1)]
             for degree, band in enumerate(read["harmonics"], 1)]
    higher = (np.concatenate(bands, axis=1) if bands else np.zeros((count, 0))) / 128 - 1
    return {
        "position": np.array(read["position"]).reshape(count, 3),
        "covariance": np.array(read["covariance"]).reshape(count, 6),
        "colour": colours[:, :3], "opacity": colours[:, 3:],
        "harmonics": higher.reshape(count, higher.shape[1] // 3, 3),
    }, np.array(read["node"]).reshape(4, 4).T


def of_spark(rows, like):
    """The Gaussians of a file that spark.mjs prints, with the harmonics of a scene, since it prints none."""
    rows = np.array(rows, dtype=float)
    return {
        "position": rows[:, :3], "covariance": covariances(rows[:, [9, 6, 7, 8]], rows[:, 3:6]),
        "colour": rows[:, 11:], "opacity": rows[:, 10:11], "harmonics": like["harmonics"],
    }


def of_mesh_ply(path):
    """The mesh in a PLY file as plyfile reads it; colours in linear light."""
    read = plyfile.PlyData.read(path)
    vertices = read["vertex"].data

    def columns(*names):
        return np.stack([vertices[name].astype(float) for name in names], axis=1)

    colours = columns("red", "green", "blue") / 255
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    triangles = np.stack(read["face"].data["vertex_indices"])
    return {"position": columns("x", "y", "z"), "normal": columns("nx", "ny", "nz"), "colour": linear, "triangles": triangles}


def of_three_mesh(text):
    """The mesh that peers.mjs prints."""
    read = json.loads(text)
    mesh = {part: np.array(read[part]) for part in ("position", "normal", "colour")}
    return {**mesh, "triangles": np.array(read["triangles"]).reshape(-1, 3)}


def mesh_turned(mesh):
    """A mesh after half a turn about x, which makes y point up."""
    signs = np.array([1, -1, -1])
    return {**mesh, "position": mesh["position"] * signs, "normal": mesh["normal"] * signs}


def mesh_faults(mesh):
    """Faults of a mesh, as any program reads it."""
    a, b, c = (mesh["position"][corners] for corners in mesh["triangles"].T)
    across = np.cross(b - a, c - a)
    along = [np.einsum("ij,ij->i", across, mesh["normal"][corners]) for corners in mesh["triangles"].T]
    agree = np.max(along, axis=0) > 0
    lengths = np.linalg.norm(mesh["normal"], axis=1)
    faults = {
        "triangles without an area": (np.linalg.norm(across, axis=1) == 0).mean(),
        "normals that are not unit vectors": (np.abs(lengths - 1) > 1e-4).mean(),
        # Sharp folds have some.
        "triangles against their normals": max(0, (~agree).mean() - 0.05),
        "vertices of no triangle": 1 - len(np.unique(mesh["triangles"])) / len(lengths),
    }
    return [name for name, share in faults.items() if share > 0]


def of_usd(path):
    """The Gaussians of the only ParticleField3DGaussianSplat in a USD file, in the world with y up, and the matrix above them."""
    from pxr import Usd, UsdGeom, UsdVol

    stage = Usd.Stage.Open(str(path))
    found = [prim for prim in stage.Traverse() if prim.IsA(UsdVol.ParticleField3DGaussianSplat)]
    if len(found) != 1 or not found[0].IsDefined() or UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.y:
        raise SystemExit(f"{path} holds {len(found)} splats, up is {UsdGeom.GetStageUpAxis(stage)}")
    schema = found[0].GetPrimDefinition()
    foreign = [a.GetName() for a in found[0].GetAuthoredAttributes() if a.GetName() not in schema.GetPropertyNames()]
    if foreign:
        raise SystemExit(f"{path}: the schema has no attributes {foreign}")
    own = {a.GetName(): a.Get() for a in found[0].GetAuthoredAttributes()}
    positions = np.array(own["positions"], dtype=float)
    coefficients = (own["radiance:sphericalHarmonicsDegree"] + 1) ** 2
    sh = np.array(own["radiance:sphericalHarmonicsCoefficients"], dtype=float).reshape(len(positions), coefficients, 3)
    rotations = np.array([[q.GetReal(), *q.GetImaginary()] for q in own["orientations"]])
    extent = np.array(own["extent"], dtype=float)
    if not ((positions > extent[0]) & (positions < extent[1])).all():
        raise SystemExit(f"{path}: Gaussians outside of the extent {extent.tolist()}")
    return {
        "position": positions,
        "covariance": covariances(rotations, np.array(own["scales"], dtype=float)),
        "colour": 0.5 + Y00 * sh[:, 0],
        "opacity": np.array(own["opacities"], dtype=float)[:, None],
        "harmonics": sh[:, 1:],
    }, np.array(UsdGeom.XformCache().GetLocalToWorldTransform(found[0])).T


def y_up(scene):
    """The same Gaussians after half a turn about x."""
    signs = np.ones(scene["harmonics"].shape[1])
    signs[[n for n in ODD if n < len(signs)]] = -1
    return scene | {
        "position": scene["position"] * [1, -1, -1], "covariance": scene["covariance"] * [1, -1, -1, 1, 1, 1],
        "harmonics": scene["harmonics"] * signs[:, None],
    }


def tilt(node, cameras):
    """How far the horizontal axes of cameras in cameras.json are from horizontal after a node, degrees, in the mean."""
    right = np.array([camera["world_to_camera"][0][:3] for camera in cameras])
    shown = right * [1, -1, -1] @ node[:3, :3].T
    return np.degrees(np.abs(np.arcsin(shown[:, 1] / np.linalg.norm(shown, axis=1)))).mean()


def trace(scene):
    return scene["covariance"][:, [0, 3, 5]].sum(axis=1, keepdims=True)


def along_curve(scene):
    """The same Gaussians along the Morton curve: 21 bits of x, y and z in turn, from the least significant one."""
    places = scene["position"].astype(np.float32).astype(float)
    width = np.ptp(places, axis=0)
    shares = (places - places.min(axis=0)) / np.where(width > 0, width, 1)
    steps = np.floor(shares * (2**21 - 1) + 0.5).astype(np.int64)
    keys = sum((steps[:, axis] >> bit & 1) << 3 * bit + axis for bit in range(21) for axis in range(3))
    order = np.argsort(keys, kind="stable")
    return {name: values[order] for name, values in scene.items()}


def differences(ours, theirs):
    """The largest difference of each part of scenes in one order.

    Positions relative to the scene's longest side; shapes as covariances over their trace; sizes as the logarithm of the
    trace; colours and harmonics within the range that bytes have.
    """
    if len(ours["position"]) != len(theirs["position"]) or ours["harmonics"].shape != theirs["harmonics"].shape:
        raise SystemExit(f"{theirs['harmonics'].shape} Gaussians and harmonics, ours are {ours['harmonics'].shape}")
    traces = trace(ours), trace(theirs)
    apart = {
        "position": (ours["position"] - theirs["position"]) / np.ptp(ours["position"], axis=0).max(),
        "size": np.log(traces[0] / traces[1]) / 2,
        "shape": ours["covariance"] / traces[0] - theirs["covariance"] / traces[1],
        "colour": np.clip(ours["colour"], 0, 1) - np.clip(theirs["colour"], 0, 1),
        "opacity": ours["opacity"] - theirs["opacity"],
        "harmonics": np.clip(ours["harmonics"], -1, 127 / 128) - np.clip(theirs["harmonics"], -1, 127 / 128),
    }
    return {name: float(np.abs(values).max(initial=0)) for name, values in apart.items()}
