"""Facets of geoms: against closed forms, fine meshes and symmetry."""

import math
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import elliprg

from mjgranular import Explicit, GranularWarning, InputError, Rft2dLaw, Rft3dLaw, Sand, media
from mjgranular.shape import facets_from_model, tessellation

GENERIC = Rft2dLaw.generic(1.0)
QUIKRETE = Rft3dLaw.from_medium(media["quikrete_medium"])
LAWS = {"rft2d": GENERIC, "rft3d": QUIKRETE}

# Type and size as MJCF has them.
SHAPES = {
    "sphere": ("sphere", (0.05,)),
    "capsule": ("capsule", (0.03, 0.03)),
    "needle": ("capsule", (0.005, 0.095)),
    "cylinder": ("cylinder", (0.04, 0.04)),
    "rod": ("cylinder", (0.01, 0.06)),
    "disc": ("cylinder", (0.05, 0.01)),
    "ellipsoid": ("ellipsoid", (0.06, 0.04, 0.02)),
    "cigar": ("ellipsoid", (0.01, 0.01, 0.05)),
    "lentil": ("ellipsoid", (0.05, 0.05, 0.01)),
    "cube": ("box", (0.04, 0.04, 0.04)),
    "brick": ("box", (0.08, 0.04, 0.02)),
    "plate": ("box", (0.05, 0.05, 0.005)),
    "beam": ("box", (0.01, 0.1, 0.01)),
}
CURVED = [name for name, (kind, _) in SHAPES.items() if kind != "box"]
BOXES = [name for name, (kind, _) in SHAPES.items() if kind == "box"]

BODY = """
<mujoco>
  <worldbody>
    <body name="body">
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      {}
    </body>
  </worldbody>
</mujoco>
"""


def geom(name, extra=""):
    kind, size = SHAPES[name]
    return f"<geom name='{name}' type='{kind}' size='{' '.join(map(str, size))}' {extra}/>"


def body(*geoms):
    return mujoco.MjModel.from_xml_string(BODY.format("".join(geoms)))


def facets(name, resolution=8):
    return facets_from_model(body(geom(name)), [0], resolution)


def matrix(quaternion):
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, np.asarray(quaternion, float))
    return out.reshape(3, 3)


def drawn_rotation(rng):
    quaternion = rng.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


def drawn_direction(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


class Pushed:
    """A free body under a law, and the wrench of the sand at any state.

    It goes by `apply`: `report` tells of every element, which takes long for fine meshes.
    """

    def __init__(self, model, law, resolution=None):
        self.sand = Sand(
            model, law=law, resolution=resolution, scheme=Explicit(half_step=False), bodies="body"
        )
        self.data = mujoco.MjData(model)

    def wrench(self, position, quaternion, velocity, spin=(0, 0, 0)):
        model, data = self.sand.model, self.data
        data.qpos[:3], data.qpos[3:] = position, quaternion
        data.qvel[:3], data.qvel[3:] = velocity, matrix(quaternion).T @ spin
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        data.xfrc_applied[:] = 0
        self.sand.apply(data)
        return data.xfrc_applied[1].copy()

    def force(self, *state):
        return self.wrench(*state)[:3]


def mesh_model(vertices, faces, *, position=(0, 0, 0), quaternion=(1, 0, 0, 0)):
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="mesh")
    mesh.uservert = np.asarray(vertices, float).ravel()
    mesh.userface = np.asarray(faces).ravel()
    # A sheet has no volume; the masses of these bodies are given.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    holder = spec.worldbody.add_body(name="body")
    holder.add_freejoint()
    holder.mass, holder.inertia, holder.explicitinertial = 1.0, [1, 1, 1], True
    holder.add_geom(
        name="mesh",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="mesh",
        pos=position,
        quat=quaternion,
    )
    return spec.compile()


# Closed forms: area and volume


def area_and_volume(name):
    kind, size = SHAPES[name]
    if kind in ("sphere", "ellipsoid"):
        a, b, c = size if len(size) == 3 else size * 3
        area = 4 * math.pi * elliprg((a * b) ** 2, (b * c) ** 2, (c * a) ** 2)
        return area, 4 / 3 * math.pi * a * b * c
    if kind == "box":
        a, b, c = size
        return 8 * (a * b + b * c + c * a), 8 * a * b * c
    r, h = size
    side, core = 4 * math.pi * r * h, 2 * math.pi * r * r * h
    if kind == "cylinder":
        return side + 2 * math.pi * r * r, core
    return side + 4 * math.pi * r * r, core + 4 / 3 * math.pi * r**3


def volume(cut):
    return (cut["point"] * cut["normal"] * cut["area"][:, None]).sum() / 3


def test_closed_forms_of_the_test_itself():
    a, b = 0.05, 0.01  # oblate spheroid, Beyer's tables
    e = math.sqrt(1 - b * b / (a * a))
    oblate = 2 * math.pi * a * a + math.pi * b * b / e * math.log((1 + e) / (1 - e))
    assert area_and_volume("lentil")[0] == pytest.approx(oblate, rel=1e-12)
    assert area_and_volume("sphere")[0] == pytest.approx(4 * math.pi * 0.05**2, rel=1e-12)


@pytest.mark.parametrize("name", CURVED)
def test_area_and_volume_converge_at_second_order(name):
    errors = []
    for resolution in (4, 8, 16, 32):
        cut = facets(name, resolution)
        area, inside = area_and_volume(name)
        errors.append([abs(cut["area"].sum() / area - 1), abs(volume(cut) / inside - 1)])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders[1:] == pytest.approx(2.0, abs=0.2)
    assert max(errors[1]) < 0.03  # the default


@pytest.mark.parametrize("name", BOXES)
def test_area_and_volume_of_a_box_are_exact(name):
    cut = facets(name)
    area, inside = area_and_volume(name)
    assert cut["area"].sum() == pytest.approx(area, rel=1e-13)
    assert volume(cut) == pytest.approx(inside, rel=1e-13)


@pytest.mark.parametrize("resolution", [2, 3, 8, 9])
@pytest.mark.parametrize("name", SHAPES)
def test_skin_is_closed(name, resolution):
    cut = facets(name, resolution)
    leak = (cut["normal"] * cut["area"][:, None]).sum(axis=0)
    # The area of a curved facet exceeds that of its normal vector, alike on all sides.
    assert np.abs(leak).max() < 1e-14 * cut["area"].sum()


@pytest.mark.parametrize("name", SHAPES)
def test_centroids(name):
    # Of the upper half's skin: the middle of half a sphere is at r/2 (Archimedes).
    kind, size = SHAPES[name]
    if kind == "ellipsoid":
        pytest.skip("no closed form")
    r, h = size[0], size[-1]
    parts = {  # (area, height of its centroid)
        "sphere": [(2 * math.pi * r * r, r / 2)],
        "capsule": [(2 * math.pi * r * h, h / 2), (2 * math.pi * r * r, h + r / 2)],
        "cylinder": [(2 * math.pi * r * h, h / 2), (math.pi * r * r, h)],
        "box": [(4 * (size[0] + size[-2]) * h, h / 2), (4 * size[0] * size[-2], h)],
    }[kind]
    expected = sum(a * z for a, z in parts) / sum(a for a, _ in parts)
    errors = []
    for resolution in (8, 16):
        cut = facets(name, resolution)
        upper = cut[cut["point"][:, 2] > 1e-12]
        middle = (upper["point"] * upper["area"][:, None]).sum(axis=0) / upper["area"].sum()
        assert middle[:2] == pytest.approx([0, 0], abs=1e-15)
        errors.append(abs(middle[2] / expected - 1))
        if kind != "box" or cut["point"][:, 2].min() == -cut["point"][:, 2].max():
            assert (cut["point"] * cut["area"][:, None]).sum(axis=0) == pytest.approx(
                np.zeros(3), abs=1e-16
            )
    assert errors[0] < 2e-3
    assert errors[1] < errors[0] / 3.5 or errors[1] < 1e-13


@pytest.mark.parametrize("name", SHAPES)
def test_normals_point_outward(name):
    cut = facets(name)
    assert np.linalg.norm(cut["normal"], axis=1) == pytest.approx(1, abs=1e-14)
    assert ((cut["normal"] * cut["point"]).sum(axis=1) > 0).all()  # convex, the origin inside


@pytest.mark.parametrize("name", ["sphere", "ellipsoid"])
def test_normals_are_those_of_the_skin(name):
    size = np.broadcast_to(SHAPES[name][1], 3)
    largest = []
    for resolution in (8, 16, 32):
        cut = facets(name, resolution)
        gradient = cut["point"] / size**2
        gradient /= np.linalg.norm(gradient, axis=1)[:, None]
        # The two rings at the poles are cut unevenly by area.
        away = np.abs(gradient[:, 2]) < 0.9
        largest.append(np.linalg.norm(cut["normal"] - gradient, axis=1)[away].max())
    assert largest[0] < 0.1
    assert largest[2] < largest[1] / 2.5 < largest[0] / 6


@pytest.mark.parametrize("resolution", [5, 8])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_mirror_images(name, axis, resolution):
    cut = facets(name, resolution)
    scale = np.abs(cut["point"]).max()
    rows = np.column_stack(
        [cut["point"] / scale, cut["normal"], cut["area"][:, None] / cut["area"].max()]
    )
    images = rows.copy()
    images[:, [axis, 3 + axis]] *= -1
    away, index = cKDTree(rows).query(images)
    assert away.max() < 3e-15
    assert len(set(index)) == len(rows)  # each has an image of its own


@pytest.mark.parametrize("name", SHAPES)
def test_geom_away_from_the_origin_of_its_body(name):
    rotation = drawn_rotation(np.random.default_rng(5))
    place = "pos='0.1 -0.2 0.3' quat='{} {} {} {}'".format(*map(repr, map(float, rotation)))
    plain = facets(name)
    moved = facets_from_model(body(geom(name, place)), [0], 8)
    R = matrix(rotation)
    expected = plain["point"] @ R.T + [0.1, -0.2, 0.3]
    assert np.abs(moved["point"] - expected).max() < 1e-15
    assert np.abs(moved["normal"] - plain["normal"] @ R.T).max() < 1e-15
    assert (moved["area"] == plain["area"]).all()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ["needle", "ellipsoid", "brick"])
def test_where_in_its_body_a_geom_is_does_not_matter(name, law):
    # The same place in the world; the moment is about the body's centre of mass, so it moves.
    rng = np.random.default_rng(8)
    inner, offset = drawn_rotation(rng), np.array([0.1, -0.2, 0.3])
    place = "pos='0.1 -0.2 0.3' quat='{} {} {} {}'".format(*map(repr, map(float, inner)))
    plain, moved = Pushed(body(geom(name)), LAWS[law]), Pushed(body(geom(name, place)), LAWS[law])
    for _ in range(20):
        outer, velocity, spin = drawn_rotation(rng), drawn_direction(rng), 5 * drawn_direction(rng)
        position = np.array([0.3, 0.1, rng.uniform(-0.2, 0.05)])
        whole = np.zeros(4)
        mujoco.mju_mulQuat(whole, outer, inner)
        arm = matrix(outer) @ offset
        found = moved.wrench(position - arm, outer, velocity - np.cross(spin, arm), spin)
        expected = plain.wrench(position, whole, velocity, spin)
        expected[3:] += np.cross(arm, expected[:3])
        assert found == pytest.approx(expected, abs=1e-9 * np.linalg.norm(expected) + 1e-12)


# Fine meshes of our own: surfaces of revolution, and boxes


def revolved(radius, height, around):
    """Triangles of a curve turned about z, from one pole to the other (radius 0 at both ends)."""
    n = len(radius) - 2
    turn = 2 * math.pi * np.arange(around) / around
    rings = np.stack(
        [
            radius[1:-1, None] * np.cos(turn),
            radius[1:-1, None] * np.sin(turn),
            np.repeat(height[1:-1, None], around, axis=1),
        ],
        axis=-1,
    )
    vertices = np.concatenate([rings.reshape(-1, 3), [[0, 0, height[0]], [0, 0, height[-1]]]])
    j = np.arange(around)
    k = (j + 1) % around
    last = (n - 1) * around
    faces = [
        np.stack([k, j, np.full(around, n * around)], 1),
        np.stack([last + j, last + k, np.full(around, n * around + 1)], 1),
    ]
    for i in range(n - 1):
        a, b = i * around + j, i * around + k
        faces += [np.stack([a, b, b + around], 1), np.stack([a, b + around, a + around], 1)]
    return vertices, np.concatenate(faces)


def profile(name, fine):
    kind, size = SHAPES[name]
    arc = np.linspace(0, math.pi, fine + 1)
    if kind in ("sphere", "ellipsoid"):
        return np.sin(arc), -np.cos(arc)
    r, h = size
    if kind == "capsule":
        quarter = np.linspace(0, math.pi / 2, fine // 3 + 1)
        radius = np.concatenate([np.sin(quarter), np.cos(quarter)])
        height = np.concatenate([-h / r - np.cos(quarter), h / r + np.sin(quarter)])
    else:
        ramp = np.linspace(0, 1, fine // 3 + 1)
        radius = np.concatenate([ramp, 1 - ramp])
        height = np.concatenate([-h / r + 0 * ramp, h / r + 0 * ramp])
    side = np.linspace(-h / r, h / r, max(fine // 3, int(fine * h / r / 4)) + 1)[1:-1]
    half = len(radius) // 2
    radius = np.concatenate([radius[:half], np.ones(len(side)), radius[half:]])
    return r * radius, r * np.concatenate([height[:half], side, height[half:]])


def box_mesh(halves, fine):
    """Each face of the box is a grid of its own; vertices at the same place count as one."""
    vertices, faces = [], []
    counts = [max(8, int(fine * half / max(halves))) for half in halves]
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        n, m = counts[first], counts[second]
        u, v = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, m + 1), indexing="ij")
        for side in (1, -1):
            grid = np.zeros((n + 1, m + 1, 3))
            grid[..., axis] = side * halves[axis]
            grid[..., first], grid[..., second] = halves[first] * u, halves[second] * v
            a = (np.arange(n)[:, None] * (m + 1) + np.arange(m)).ravel() + sum(map(len, vertices))
            b, c, d = a + m + 1, a + m + 2, a + 1
            pair = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
            faces.append(pair if side > 0 else pair[:, ::-1])
            vertices.append(grid.reshape(-1, 3))
    return np.concatenate(vertices), np.concatenate(faces)


@cache
def fine_mesh(name, fine=90):
    kind, size = SHAPES[name]
    if kind == "box":
        return box_mesh(size, fine)
    vertices, faces = revolved(*profile(name, fine), 2 * fine)
    if kind in ("sphere", "ellipsoid"):
        vertices = vertices * size
    return vertices, faces


@cache
def pushed(name, law, resolution=None):
    return Pushed(body(geom(name)), LAWS[law], resolution)


@cache
def pushed_mesh(name, law):
    return Pushed(mesh_model(*fine_mesh(name)), LAWS[law])


@pytest.mark.parametrize("name", SHAPES)
def test_meshes_of_the_test_itself(name):
    vertices, faces = fine_mesh(name)
    corners = vertices[faces]
    area, inside = area_and_volume(name)
    found = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert found == pytest.approx(inside, rel=2e-3)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(doubled, axis=1).sum() / 2 == pytest.approx(area, rel=1e-3)


def poses(name, count, *, submerged, seed=0):
    """Random orientations, depths and directions of motion.

    `submerged`: wholly, or a quarter to all of the height.
    """
    rng = np.random.default_rng(seed)
    vertices, _ = fine_mesh(name)
    for _ in range(count):
        quaternion = drawn_rotation(rng)
        heights = vertices @ matrix(quaternion)[2]
        low, high = heights.min(), heights.max()
        if submerged:
            height = -high - rng.uniform(0, 0.1)
        else:
            height = -low - rng.uniform(0.25, 1) * (high - low)
        yield np.array([0, 0, height]), quaternion, drawn_direction(rng)


def force_errors(name, law, resolution=None, *, submerged, count=40):
    """Errors of total force against the fine mesh; each is relative to two forces.

    To the force itself, where that is not less than a tenth of the resistance to being pressed
    straight down in the same pose (a body that is pulled out of the sand hardly feels it); and to
    the latter.
    """
    own, scale = [], []
    for position, quaternion, velocity in poses(name, count, submerged=submerged):
        true = pushed_mesh(name, law).force(position, quaternion, velocity)
        down = np.linalg.norm(pushed_mesh(name, law).force(position, quaternion, [0, 0, -1]))
        found = pushed(name, law, resolution).force(position, quaternion, velocity)
        error = np.linalg.norm(found - true)
        scale.append(error / down)
        if np.linalg.norm(true) >= 0.1 * down:
            own.append(error / np.linalg.norm(true))
    return np.array(own), np.array(scale)


def worst(name, law, resolution, submerged):
    own, scale = force_errors(name, law, resolution, submerged=submerged)
    return own.max(), scale.max()
