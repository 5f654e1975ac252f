"""Facets of geoms: against closed forms, fine meshes and symmetry."""

import math
import re
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.special import elliprg

from mjgranular import Explicit, GranularWarning, InputError, Rft2dLaw, Rft3dLaw, Sand, media
from mjgranular.shape import facets_from_model
from mjgranular.shape.facets import FINEST
from mjgranular.shape.sizes import RESOLUTION

pytestmark = [
    pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning"),
    pytest.mark.filterwarnings("ignore::mjgranular.errors.CostWarning"),
]

GENERIC = Rft2dLaw.generic(1.0)
QUIKRETE = Rft3dLaw.from_medium(media["quikrete_medium"])
LAWS = {"rft2d": GENERIC, "rft3d": QUIKRETE}


def on_triangles(law):
    """A law that acts on a mesh's own triangles, to compare with."""

    class Fine(type(law)):
        def elements(self, model, geoms, resolution=None):
            return facets_from_model(model, geoms, resolution, sheltered="keep", meshes="triangles")

    return Fine(**vars(law))


FINE = {name: on_triangles(law) for name, law in LAWS.items()}

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


def facets(name, resolution=RESOLUTION):
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
def test_area_and_volume_converge(name):
    errors = []
    for finer in (1, 2, 4):
        cut = facets(name, finer * RESOLUTION)
        area, inside = area_and_volume(name)
        errors.append([abs(cut["area"].sum() / area - 1), abs(volume(cut) / inside - 1)])
    assert errors[0][0] < 2e-3
    assert errors[0][1] < 1e-2
    # Second order, but for a logarithm where the rings at a pole, of few patches, have a say: in
    # areas, and in the small error of a wheel's volume, whose side is finer than its ends.
    orders = np.log2(np.array(errors[0]) / np.array(errors[2])) / 2
    assert orders.min() > 1.3
    assert orders[1] > 1.8 or errors[0][1] < 6e-4


@pytest.mark.parametrize("name", BOXES)
def test_area_and_volume_of_a_box_are_exact(name):
    cut = facets(name)
    area, inside = area_and_volume(name)
    assert cut["area"].sum() == pytest.approx(area, rel=1e-13)
    assert volume(cut) == pytest.approx(inside, rel=1e-13)


@pytest.mark.parametrize("resolution", [2, 9])
@pytest.mark.parametrize("name", SHAPES)
def test_skin_is_closed(name, resolution):
    cut = facets(name, resolution)
    leak = (cut["normal"] * cut["area"][:, None]).sum(axis=0)
    # The area of a curved facet exceeds that of its normal vector, alike on all sides.
    assert np.abs(leak).max() < 1e-14 * cut["area"].sum()


def second_moment(name):
    """Of the skin about the plane z = 0, the integral of z^2 dA."""
    kind, size = SHAPES[name]
    r, h = size[0], size[-1]
    if kind == "sphere":
        return 4 / 3 * math.pi * r**4
    if kind == "box":
        return 8 * size[0] * size[1] * h**2 + 4 * (size[0] + size[1]) * 2 / 3 * h**3
    side = 4 / 3 * math.pi * r * h**3
    if kind == "cylinder":
        return side + 2 * math.pi * r**2 * h**2
    return side + 4 / 3 * math.pi * r * ((h + r) ** 3 - h**3)  # dA = 2 pi r dz on a sphere


@pytest.mark.parametrize("resolution", [4, 48])
@pytest.mark.parametrize("name", [name for name in SHAPES if SHAPES[name][0] != "ellipsoid"])
def test_moments(name, resolution):
    cut = facets(name, resolution)
    middle = (cut["point"] * cut["area"][:, None]).sum(axis=0) / cut["area"].sum()
    assert middle == pytest.approx(np.zeros(3), abs=1e-16)
    # A parallelogram of half edges e has the second moments e e^T / 3 about its centroid.
    own = (cut["edges"][:, :, 2] ** 2).sum(axis=1) / 3
    moment = ((cut["point"][:, 2] ** 2 + own) * cut["area"]).sum()
    error = abs(moment / second_moment(name) - 1)
    assert error < {4: 3e-3, 48: 1.6e-4}[resolution]
    if SHAPES[name][0] == "box":
        assert error < 1e-13


@pytest.mark.parametrize("resolution", [2, 12])
@pytest.mark.parametrize("name", SHAPES)
def test_edges_lie_in_the_facet(name, resolution):
    cut = facets(name, resolution)
    lengths = np.linalg.norm(cut["edges"], axis=2)
    assert lengths.min() > 0
    across = np.abs(np.einsum("nki,ni->nk", cut["edges"], cut["normal"]))
    assert (across / lengths).max() < (0.1 if resolution < 12 else 0.05)
    # Close to the area of the parallelogram; a sector at a pole is not one.
    area = 4 * np.linalg.norm(np.cross(cut["edges"][:, 0], cut["edges"][:, 1]), axis=1)
    share = area / cut["area"]
    assert share.max() < 1.02
    assert share.min() > 0.6
    assert np.median(share) > 0.75


@pytest.mark.parametrize("name", SHAPES)
def test_spread_is_the_curvature_of_the_skin(name):
    cut = facets(name, 48)
    edges, spread, normal, point = (cut[key] for key in ("edges", "spread", "normal", "point"))
    kind, size = SHAPES[name]
    if kind == "box":
        expected = 0 * edges
    elif kind in ("sphere", "ellipsoid"):
        # The normal is along the gradient of |x / a|^2: its change along an edge, across itself.
        scale = np.broadcast_to(size, 3) ** -2.0
        steep = np.linalg.norm(point * scale, axis=1)[:, None, None]
        change = edges * scale / steep
        along = np.einsum("nki,ni->nk", change, normal)
        expected = change - along[:, :, None] * normal[:, None, :]
    else:
        # About the axis on the side, about the centres of the ends of a capsule, none on a disc.
        r, h = size
        expected = edges / r
        side = np.abs(point[:, 2]) < h - 1e-9
        expected[side, :, 2] = 0
        if kind == "cylinder":
            expected[~side] = 0
    # A few sectors at the poles apart, which the slopes do not describe.
    error = np.linalg.norm(spread - expected, axis=2).max(axis=1)
    assert np.quantile(error, 0.98) < 0.02 * max(np.linalg.norm(expected, axis=2).max(), 1e-12)
    assert error.max() < 0.15 * max(np.linalg.norm(expected, axis=2).max(), 1e-12)


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


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_mirror_images(name, axis):
    cut = facets(name, 5)
    scale = np.abs(cut["point"]).max()
    mirror = np.ones(3)
    mirror[axis] = -1

    def rows_of(mirror):
        # Edges and spread may change places and signs together: these sums do not.
        edges, spread = cut["edges"] / scale * mirror, cut["spread"] * mirror
        sums = [np.einsum("nki,nkj->nij", *pair).reshape(-1, 9)
                for pair in ((edges, edges), (edges, spread), (spread, spread))]  # fmt: skip
        area = cut["area"][:, None] / cut["area"].max()
        return np.column_stack([cut["point"] / scale * mirror, cut["normal"] * mirror, area, *sums])

    rows, images = rows_of(np.ones(3)), rows_of(mirror)
    away, index = cKDTree(rows).query(images, p=np.inf)
    assert away.max() < 1e-14  # rounding of normals and of their differences
    assert len(set(index)) == len(rows)  # each has an image of its own


@pytest.mark.parametrize("name", SHAPES)
def test_geom_away_from_the_origin_of_its_body(name):
    rotation = drawn_rotation(np.random.default_rng(5))
    place = "pos='0.1 -0.2 0.3' quat='{} {} {} {}'".format(*map(repr, map(float, rotation)))
    plain = facets(name)
    moved = facets_from_model(body(geom(name, place)), [0])
    R = matrix(rotation)
    expected = plain["point"] @ R.T + [0.1, -0.2, 0.3]
    assert np.abs(moved["point"] - expected).max() < 1e-15
    assert np.abs(moved["normal"] - plain["normal"] @ R.T).max() < 1e-15
    assert (moved["area"] == plain["area"]).all()
    for key in ("edges", "spread"):
        assert np.abs(moved[key] - plain[key] @ R.T).max() < 1e-15


@pytest.mark.parametrize(("name", "law"), [("needle", "rft2d"), ("brick", "rft3d")])
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


# Skin inside other geoms


def union(*geoms):
    model = body(*geoms)
    return facets_from_model(model, range(model.ngeom), sheltered="keep")


def leak(cut):
    return np.abs((cut["normal"] * cut["area"][:, None]).sum(axis=0)).max() / cut["area"].sum()


def test_two_spheres_are_cut_to_their_outside():
    r, d = 0.05, 0.06
    cut = union(
        f"<geom type='sphere' size='{r}' pos='{-d / 2} 0 0'/>",
        f"<geom type='sphere' size='{r}' pos='{d / 2} 0 0'/>",
    )
    height = r - d / 2
    lens = 2 / 3 * math.pi * height**2 * (3 * r - height)
    assert cut["area"].sum() == pytest.approx(
        8 * math.pi * r**2 - 4 * math.pi * r * height, rel=0.01
    )
    assert volume(cut) == pytest.approx(8 / 3 * math.pi * r**3 - lens, rel=0.015)
    assert leak(cut) < 1e-3
    assert (np.abs(cut["point"][:, 0]) * np.sign(cut["geom"] - 0.5) * cut["point"][:, 0] >= 0).all()


INNER = {
    "capsule": "<geom type='capsule' size='.01' fromto='0 0 -.05 0 0 .09'/>",
    "cylinder": "<geom type='cylinder' size='.012 .07' euler='0 90 0'/>",
    "ellipsoid": "<geom type='ellipsoid' size='.012 .02 .08'/>",
    "box": "<geom type='box' size='.08 .01 .013'/>",
    "sphere": "<geom type='sphere' size='.03' pos='.04 .01 .02'/>",
}


# Each as the inner and as the outer one, twice.
OUTER = ("sphere", "cube", "cylinder", "capsule", "ellipsoid")
PAIRS = [
    (outer, inner)
    for k in (0, 2)
    for outer, inner in zip(OUTER, [*INNER][k:] + [*INNER][:k], strict=True)
]


@pytest.mark.parametrize(("outer", "inner"), PAIRS)
def test_what_pokes_out_is_what_is_left(inner, outer):
    model = body(geom(outer), INNER[inner])
    cut = facets_from_model(model, [0, 1], sheltered="keep")
    # Closed, up to the size of a cell: what was cut out of the one is where the other comes out.
    assert leak(cut) < 0.01
    # What is inside by MuJoCo's own opinion: every ray meets the geom.
    plain = facets_from_model(model, [0, 1], resolution=48, hidden="keep", sheltered="keep")
    seen = sum(facet["area"] for facet in plain if not inside(model, 1 - facet["geom"], facet))
    assert seen < 0.97 * plain["area"].sum()
    assert cut["area"].sum() == pytest.approx(seen, rel=0.03)


def inside(model, geom, facet):
    R = matrix(model.geom_quat[geom])
    point = (facet["point"] - model.geom_pos[geom]) @ R
    size, kind = model.geom_size[geom], int(model.geom_type[geom])
    here = (np.zeros(3), np.eye(3).ravel(), size, point)
    along = np.array([0.3, 0.5, 0.8])
    return all(mujoco.mju_rayGeom(*here, sign * along, kind, None) >= 0 for sign in (1, -1))


@pytest.mark.parametrize("name", SHAPES)
def test_same_geom_twice_counts_once(name):
    place = "pos='.01 .02 .03' quat='.5 .1 -.7 .3'"
    model = body(geom(name, place), geom(name, place).replace(f"name='{name}'", ""))
    once = facets_from_model(model, [0])
    for twice in (facets_from_model(model, [0, 1]), facets_from_model(model, [1, 0])):
        assert (twice == once).all()
    assert len(facets_from_model(model, [0, 1], hidden="keep")) == 2 * len(once)


@pytest.mark.parametrize(
    "kinds", [("mesh", "mesh"), ("mesh", "twin"), ("mesh", "box"), ("box", "mesh")]
)
def test_mesh_at_the_place_of_another_geom_counts_once(kinds):
    spec = mujoco.MjSpec()
    for name in ("mesh", "twin"):
        spec.add_mesh(name=name, uservert=(0.02 * CORNERS).ravel(), userface=SIDES.ravel())
    holder = spec.worldbody.add_body(name="body")
    holder.add_freejoint()
    for kind in kinds:
        if kind != "box":
            holder.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=kind)
        else:
            holder.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02])
    found = facets_from_model(spec.compile(), [0, 1])
    assert found["area"].sum() == pytest.approx(6 * 0.04**2, rel=1e-6)


def test_boxes_that_touch_are_one():
    cut = union(
        "<geom type='box' size='.02 .02 .02' pos='-.02 0 0'/>",
        "<geom type='box' size='.02 .02 .02' pos='.02 0 0'/>",
    )
    assert cut["area"].sum() == pytest.approx(0.04**2 * 10, rel=1e-12)
    assert np.abs(cut["point"][:, 0]).max() == pytest.approx(0.04)
    assert leak(cut) < 1e-15


@pytest.mark.parametrize("order", [1, -1])
def test_floors_of_one_height_count_once(order):
    geoms = [
        "<geom type='box' size='.04 .04 .01' pos='0 0 .01'/>",
        "<geom type='box' size='.02 .02 .02' pos='0 0 .02'/>",
    ][::order]
    cut = union(*geoms)
    floor = cut[cut["normal"][:, 2] < -0.5]
    assert floor["area"].sum() == pytest.approx(0.08**2, rel=1e-12)
    assert volume(cut) == pytest.approx(0.08**2 * 0.02 + 0.04**2 * 0.02, rel=1e-12)


def test_geom_within_another_has_no_facets():
    model = body(geom("sphere"), "<geom name='core' type='box' size='.01 .01 .01'/>")
    cut = facets_from_model(model, [0, 1])
    assert set(cut["geom"]) == {0}
    # On its own it is not hidden: what is not in the sand hides nothing.
    assert len(facets_from_model(model, [1])) == len(facets("cube"))


def test_mesh_shelters_and_is_hidden():
    vertices, faces = 0.02 * CORNERS, SIDES
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh", uservert=vertices.ravel(), userface=faces.ravel())
    holder = spec.worldbody.add_body(name="body")
    holder.add_freejoint()
    holder.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
    holder.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    holder.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.03, 0.03, 0.03], pos=[0, 0, 0.025])
    model = spec.compile()
    found = facets_from_model(model, range(3), meshes="triangles", sheltered="keep")
    small = facets_from_model(model, [1])
    assert (found["geom"] == 0).sum() == 6  # the floor, and of each wall the triangle below
    patches = facets_from_model(model, [0, 2])
    seen = patches["area"][patches["geom"] == 0].sum()
    assert seen == pytest.approx(0.04 * (0.04 + 4 * 0.015), rel=0.05)  # walls up to the box
    assert (found["geom"] == 1).sum() < len(small)  # by the box, not by the mesh
    assert (found["geom"] == 1).any()
    outside = facets_from_model(model, range(3), meshes="triangles")
    assert not (outside["geom"] == 1).any()  # no ray leaves a mesh that is around it


PAIR = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom name="trunk" type="capsule" size=".02" fromto="-.2 0 0 0 0 0"/>
      <body name="leg">
        {}
        <geom name="leg" type="capsule" size=".02" fromto="0 0 0 .2 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SIDE = 2 * math.pi * 0.02 * 0.2
END = 2 * math.pi * 0.02**2


@pytest.mark.parametrize(
    ("joint", "hidden"),
    [
        ("", True),  # welded
        ("<joint type='hinge' axis='0 1 0'/>", True),
        ("<joint type='hinge' axis='0 1 0'/><joint type='hinge' axis='0 0 1'/>", True),
        ("<joint type='ball'/>", True),
        ("<joint type='slide' axis='1 0 0'/>", False),
        ("<joint type='hinge' axis='0 1 0'/><joint type='slide' axis='0 0 1'/>", False),
    ],
)
def test_ends_at_a_joint_are_hidden(joint, hidden):
    model = mujoco.MjModel.from_xml_string(PAIR.format(joint))
    area = facets_from_model(model, [0, 1])["area"].sum()
    assert area == pytest.approx(2 * SIDE + (2 if hidden else 4) * END, rel=2e-3)
    assert facets_from_model(model, [0])["area"].sum() == pytest.approx(SIDE + 2 * END, rel=2e-3)


def test_far_from_the_joint_nothing_is_hidden():
    # Folded back: the leg lies in the trunk, but only in this pose. The ends at the joint are one.
    joint = "<joint type='hinge' axis='0 1 0'/>"
    text = PAIR.format(joint).replace("0 0 0 .2 0 0", "0 0 0 -.15 0 0")
    cut = facets_from_model(mujoco.MjModel.from_xml_string(text), [0, 1])
    trunk, leg = (cut["area"][cut["geom"] == k].sum() for k in (0, 1))
    assert trunk == pytest.approx(SIDE + 2 * END, rel=2e-3)
    assert leg == pytest.approx(0.75 * SIDE + END, rel=2e-3)


def test_neighbours_are_looked_at_in_the_reference_pose():
    # Whatever the number for it is: `ref` changes qpos0, not the pose.
    joint = "<joint type='hinge' axis='0 1 0' ref='30'/>"
    cut = facets_from_model(mujoco.MjModel.from_xml_string(PAIR.format(joint)), [0, 1])
    assert cut["area"].sum() == pytest.approx(2 * SIDE + 2 * END, rel=2e-3)


def test_strangers_do_not_hide_each_other():
    text = "<mujoco><worldbody>{}{}</worldbody></mujoco>"
    one = "<body><freejoint/><geom type='sphere' size='{}'/></body>"
    model = mujoco.MjModel.from_xml_string(text.format(one.format(0.05), one.format(0.02)))
    assert len(facets_from_model(model, [0, 1])) == 2 * len(facets("sphere"))


def test_grandparents_do_not_hide():
    model = mujoco.MjModel.from_xml_string(
        """
        <mujoco><worldbody><body><freejoint/><geom type="sphere" size=".05"/>
          <body><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
            <body><joint/><geom type="sphere" size=".02"/></body>
        </body></body></worldbody></mujoco>
        """
    )
    assert len(facets_from_model(model, [0, 1])) == 2 * len(facets("sphere"))


def test_body_that_is_hidden_as_a_whole():
    model = mujoco.MjModel.from_xml_string(
        """
        <mujoco><worldbody><body name="shell"><freejoint/><geom type="sphere" size=".05"/>
          <body name="core"><joint/><geom type="sphere" size=".02"/></body>
          <body name="tail" pos=".2 0 0"><joint/><geom type="sphere" size=".02"/></body>
        </body></worldbody></mujoco>
        """
    )
    sand = Sand(model, law=GENERIC)
    assert [model.body(i).name for i in np.unique(sand.elements["body"])] == ["shell", "tail"]
    assert set(sand.elements["slot"]) == {0, 1}
    data = mujoco.MjData(model)
    data.qpos[2] = -0.1
    sand.step(data)
    assert [part.body for part in sand.report(data).bodies] == ["shell", "tail"]


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
    side = np.linspace(-h / r, h / r, int(np.clip(fine * h / r / 4, fine // 3, fine)) + 1)[1:-1]
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
def fine_mesh(name, fine=60):
    kind, size = SHAPES[name]
    if kind == "box":
        return box_mesh(size, fine)
    vertices, faces = revolved(*profile(name, fine), 5 * fine)
    if kind in ("sphere", "ellipsoid"):
        vertices = vertices * size
    return vertices, faces


@cache
def pushed(name, law, resolution=None):
    return Pushed(body(geom(name)), LAWS[law], resolution)


@pytest.mark.parametrize("name", SHAPES)
def test_meshes_of_the_test_itself(name):
    vertices, faces = fine_mesh(name)
    corners = vertices[faces]
    area, inside = area_and_volume(name)
    found = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert found == pytest.approx(inside, rel=4e-3)
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(doubled, axis=1).sum() / 2 == pytest.approx(area, rel=2e-3)


@cache
def true_forces(name, law, count=30):
    """Poses, motions and the fine mesh's force; and its force when pressed straight down.

    Orientations and directions are random; depths are so that the body is wholly in the sand, or a
    quarter to all of its height: the cases of both, by `submerged`.
    """
    vertices, faces = fine_mesh(name)
    mesh = Pushed(mesh_model(vertices, faces), FINE[law])
    both = {}
    for submerged in (True, False):
        rng = np.random.default_rng(0)
        cases = both[submerged] = []
        for _ in range(count):
            quaternion, velocity = drawn_rotation(rng), drawn_direction(rng)
            heights = vertices @ matrix(quaternion)[2]
            low, high = heights.min(), heights.max()
            depth = (
                high + rng.uniform(0, 0.1)
                if submerged
                else low + rng.uniform(0.25, 1) * (high - low)
            )
            place = (np.array([0, 0, -depth]), quaternion)
            pressed = np.linalg.norm(mesh.force(*place, [0, 0, -1]))
            cases.append(((*place, velocity), mesh.force(*place, velocity), pressed))
    return both


def force_errors(name, law, resolution=None, *, submerged):
    """Errors of total force against the fine mesh, relative to two forces.

    To the force itself, where that is at least a tenth of the resistance to being pressed straight
    down in the same pose (a body that is pulled out of the sand hardly feels it); and to the
    latter.
    """
    own, pressed = [], []
    for state, true, down in true_forces(name, law)[submerged]:
        error = np.linalg.norm(pushed(name, law, resolution).force(*state) - true)
        pressed.append(error / down)
        if np.linalg.norm(true) >= 0.1 * down:
            own.append(error / np.linalg.norm(true))
    return np.array(own), np.array(pressed)


def rms(values):
    return math.sqrt((np.asarray(values) ** 2).mean())


both_depths = pytest.mark.parametrize(
    "submerged", [True, False], ids=["all in the sand", "a quarter to all"]
)
# The cut is the same for both laws: all shapes by one, the flattest of each kind by the other.
each_shape = pytest.mark.parametrize(
    ("name", "law"),
    [
        *((name, "rft3d") for name in SHAPES),
        *((name, "rft2d") for name in ("needle", "disc", "lentil", "plate")),
    ],
)
each_box = pytest.mark.parametrize(
    ("name", "law"), [*((name, "rft3d") for name in BOXES), ("plate", "rft2d")]
)


@each_box
def test_box_wholly_in_the_sand_is_exact(name, law):
    # Flat faces, stress linear in depth: all that is left is the mesh's single precision.
    own, _ = force_errors(name, law, submerged=True)
    assert own.max() < 1e-5


@pytest.mark.parametrize("name", ["capsule", "cube"])
def test_the_default_is_as_good_as_a_fine_mesh(name):
    own, pressed = force_errors(name, "rft3d", submerged=True)
    assert rms(own) < 0.01
    assert pressed.max() < 0.01


GROUPS = {
    "sphere, 3 ellipsoids": ("sphere", "ellipsoid", "cigar", "lentil"),
    "2 capsules": ("capsule", "needle"),
    "3 cylinders": ("cylinder", "rod", "disc"),
    "4 boxes": BOXES,
}


@pytest.mark.parametrize("group", GROUPS)
def test_the_page_counts_facets_as_they_are(group):
    page = (Path(__file__).parents[2] / "docs" / "shapes.md").read_text(encoding="utf-8")
    (cell,) = re.findall(rf"^\| {group} \| ([^|]+) \|", page, re.MULTILINE)
    counts = sorted(len(facets(name)) for name in GROUPS[group])
    printed = [int(word) for word in re.findall(r"\d+", cell)]
    assert (printed[0], printed[-1]) == (counts[0], counts[-1])


@pytest.mark.slow
@each_shape
@both_depths
def test_default_is_near_a_fine_mesh_and_three_times_it_nearer(name, law, submerged):
    own, pressed = force_errors(name, law, submerged=submerged)
    assert own.max() <= 0.02
    assert rms(own) < 0.01
    assert pressed.max() < 0.01
    # On average; at worst of the resistance to being pressed down in that pose.
    own, pressed = force_errors(name, law, 3 * RESOLUTION, submerged=submerged)
    assert rms(own) < 0.005
    assert pressed.max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "law"), [("needle", "rft3d"), ("disc", "rft2d"), ("ellipsoid", "rft3d")]
)
def test_total_force_converges(name, law):
    # To a still finer cut: the fine mesh itself is up to 0.2 % off.
    states = [state for state, _, _ in true_forces(name, law)[True]]
    coarse, fine, finest = (
        np.array([pushed(name, law, n).force(*state) for state in states]) for n in (12, 48, 144)
    )
    sizes = np.linalg.norm(finest, axis=1)
    errors = [rms(np.linalg.norm(cut - finest, axis=1) / sizes) for cut in (coarse, fine)]
    assert errors[1] < 1e-3
    assert math.log2(errors[0] / errors[1]) / 2 > 1.3


@each_box
def test_box_in_part_in_the_sand_is_nearly_exact(name, law):
    own, _ = force_errors(name, law, submerged=False)
    assert own.max() < 5e-3


@pytest.mark.parametrize(
    ("kind", "size", "most"), [("box", "0.02 0.02", 30.3), ("capsule", "0.02", 33.8)]
)
def test_a_stake_stands_as_firmly_as_one_of_fine_facets(kind, size, most):
    # `most` with resolution=48; 4.4 and 16.2 N with facets of 12.5 and 10 cm.
    model = mujoco.MjModel.from_xml_string(STAKE.format(kind=kind, size=size))
    sand = Sand(model)
    for push, stands in ((0.95 * most, True), (1.05 * most, False)):
        data = mujoco.MjData(model)
        data.xfrc_applied[1, 0] = push
        while data.time < 2.0 and abs(data.qpos[5]) < 0.1:
            sand.step(data)
        assert (data.time >= 2.0) == stands


STAKE = """<mujoco><worldbody><body pos="0 0 0.1"><freejoint/>
  <geom type="{kind}" size="{size} 0.25" mass="1"/></body></worldbody></mujoco>"""


# Meshes

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SIDES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def bracket():
    """An L of three unit squares, one unit thick, off its own middle: not convex."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    n = len(outline)
    vertices = np.concatenate(
        [np.column_stack([outline, np.zeros(n)]), np.column_stack([outline, np.ones(n)])]
    )
    lid = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    i = np.arange(n)
    j = (i + 1) % n
    walls = [np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]
    return vertices, np.concatenate([lid[:, ::-1], lid + n, *walls])


def mesh_facets(model):
    return facets_from_model(model, [0], sheltered="keep", meshes="triangles")


def test_triangles_of_a_mesh():
    vertices, faces = bracket()
    cut = mesh_facets(mesh_model(0.05 * vertices, faces))
    assert len(cut) == len(faces)
    assert cut["area"].sum() == pytest.approx(0.05**2 * 14, rel=1e-6)  # the hull: 12.9
    assert volume(cut) == pytest.approx(0.05**3 * 3, rel=1e-6)  # the hull: 3.5
    assert (cut["normal"] * cut["area"][:, None]).sum(axis=0) == pytest.approx(
        np.zeros(3), abs=1e-9
    )


def test_mesh_lies_where_it_was_drawn():
    # MuJoCo moves a mesh to its centre of mass and turns it to its axes of inertia.
    vertices, faces = bracket()
    turn = drawn_rotation(np.random.default_rng(2))
    model = mesh_model(0.05 * vertices, faces, position=(0.1, 0.2, 0.3), quaternion=turn)
    cut = mesh_facets(model)
    assert np.abs(model.mesh_pos[0]).max() > 0.01
    assert abs(model.mesh_quat[0, 0]) < 0.999
    drawn = 0.05 * vertices[faces].mean(axis=1) @ matrix(turn).T + [0.1, 0.2, 0.3]
    assert np.abs(cut["point"] - drawn).max() < 1e-7


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ["brick", "plate"])
def test_mesh_of_a_box_is_the_box(name, law):
    halves = np.array(SHAPES[name][1])
    rng = np.random.default_rng(4)
    turn = drawn_rotation(rng)
    box = Pushed(
        body(
            geom(name, "pos='0.01 0.02 0.03' quat='{} {} {} {}'".format(*map(repr, turn.tolist())))
        ),
        LAWS[law],
    )
    # Off its own middle as well: the mesh's frame is not the geom's.
    mesh = Pushed(
        mesh_model(
            CORNERS * halves + [0.1, 0.2, 0.3],
            SIDES,
            position=np.array([0.01, 0.02, 0.03]) - matrix(turn) @ [0.1, 0.2, 0.3],
            quaternion=turn,
        ),
        LAWS[law],
    )
    for _ in range(20):
        state = ([0, 0, -0.2], drawn_rotation(rng), drawn_direction(rng))
        expected = box.force(*state)
        assert mesh.force(*state) == pytest.approx(
            expected, abs=2e-5 * np.linalg.norm(expected)
        )  # single precision, in vertices 0.4 m from the origin


@pytest.mark.parametrize("law", LAWS)
def test_cutting_triangles_in_two_changes_nothing(law):
    # Wholly in the sand and without turning: the stress is linear in depth.
    vertices, faces = bracket()
    vertices = 0.05 * vertices
    rng = np.random.default_rng(6)
    middles = (vertices[faces[:, 0]] + vertices[faces[:, 1]]) / 2
    extra = len(vertices) + np.arange(len(faces))
    halves = np.concatenate(
        [
            np.stack([faces[:, 0], extra, faces[:, 2]], 1),
            np.stack([extra, faces[:, 1], faces[:, 2]], 1),
        ]
    )
    with pytest.warns(
        GranularWarning, match="open edges"
    ):  # new corners on their neighbours' edges
        cut = Pushed(mesh_model(np.concatenate([vertices, middles]), halves), FINE[law])
    whole = Pushed(mesh_model(vertices, faces), FINE[law])
    assert len(cut.sand.elements) == 2 * len(whole.sand.elements)
    for _ in range(20):
        state = ([0, 0, -0.3], drawn_rotation(rng), drawn_direction(rng))
        expected = whole.force(*state)
        assert cut.force(*state) == pytest.approx(expected, abs=1e-5 * np.linalg.norm(expected))


@pytest.mark.parametrize(("dropped", "gaps"), [([-1], 3), ([-1, -2], 4), ([0, 4], 6)])
def test_open_edges_are_counted(dropped, gaps):
    model = mesh_model(0.05 * CORNERS, np.delete(SIDES, dropped, axis=0))
    with pytest.warns(
        GranularWarning, match=rf"'mesh' is not watertight, it has {gaps} open edges"
    ):
        cut = mesh_facets(model)
    assert len(cut) == len(SIDES) - len(dropped)


def test_edge_of_three_faces_is_open():
    # A fin on an edge of a cube: two edges of its own, and the one that has a face too many.
    fin = np.concatenate([CORNERS, [[-3, -3, 0]]])
    with pytest.warns(GranularWarning, match="it has 3 open edges"):
        mesh_facets(mesh_model(0.05 * fin, [*SIDES, [0, 1, 8]]))


def test_edge_of_faces_turned_opposite_ways_is_open():
    # The floor alone is turned: every edge has two faces.
    faces = SIDES.copy()
    down = CORNERS[faces][:, :, 2].max(axis=1) < 0
    faces[down] = faces[down][:, ::-1]
    with pytest.warns(GranularWarning, match="4 open edges, or edges of faces turned opposite"):
        mesh_facets(mesh_model(0.05 * CORNERS, faces))


def test_open_sheet_is_pushed_on_its_outer_side():
    # Two squares of a cube, turned inwards (MuJoCo makes no mesh of one alone): the floor faces up,
    # the wall along x.
    model = mesh_model(0.05 * CORNERS, SIDES[[8, 9, 0, 1]][:, ::-1])
    with pytest.warns(GranularWarning, match="it has 6 open edges"):
        sheet = Pushed(model, FINE["rft2d"])
    up = [1, 0, 0, 0]
    assert not sheet.force([0, 0, -0.1], up, [0, 0, -1]).any()
    # Drawn upwards, alpha_z(0, -90 degrees) = -0.250 N/cm^3.
    assert sheet.force([0, 0, -0.1], up, [0, 0, 1])[2] == pytest.approx(
        -0.25e6 * 0.15 * 0.01, rel=1e-6
    )


@pytest.mark.parametrize("split", [False, True])
def test_watertight_mesh_gives_no_warning(split):
    # Warnings are errors here. A file may give each face corners of its own.
    vertices, faces = 0.05 * CORNERS, SIDES
    if split:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)
    assert len(mesh_facets(mesh_model(vertices, faces))) == 12


def test_corners_that_differ_by_rounding_are_one():
    vertices = 0.05 * CORNERS[SIDES].reshape(-1, 3)
    vertices += 1e-9 * np.random.default_rng(0).normal(size=vertices.shape)
    assert len(mesh_facets(mesh_model(vertices, np.arange(36).reshape(-1, 3)))) == 12


@pytest.mark.parametrize("missing", [0, 1])
def test_mesh_that_is_inside_out_is_turned(missing):
    # One with a hole of a forty-eighth of its surface too.
    vertices, faces = 0.05 * CORNERS, SIDES[:, ::-1]
    if missing:
        middles = vertices[faces].mean(axis=1)
        extra = len(vertices) + np.arange(len(faces))
        faces = np.concatenate(
            [np.stack([faces[:, k], faces[:, (k + 1) % 3], extra], 1) for k in range(3)]
        )[1:]
        vertices = np.concatenate([vertices, middles])
    with pytest.warns(GranularWarning) as caught:
        found = mesh_facets(mesh_model(vertices, faces))
    assert "inside out" in str(caught[-1].message)
    assert volume(found) > 0.0


def boxes_mesh(*boxes):
    """One mesh of boxes: half sizes [m], center [m], and 1, or -1 for one that is inside out."""
    vertices = np.concatenate([CORNERS * half + np.array(at) for half, at, _ in boxes])
    faces = [8 * k + SIDES[:, ::side] for k, (_, _, side) in enumerate(boxes)]
    return mesh_model(vertices, np.concatenate(faces))


FOOT = ((0.03, 0.03, 0.03), (0, 0, 0), 1)


@pytest.mark.parametrize("sides", [(1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("place", [(0.1, 0, 0), (0.03, 0.01, 0.01)])
def test_shells_of_a_mesh_are_turned_each_by_itself(sides, place):
    right = boxes_mesh(FOOT, ((0.02, 0.02, 0.02), place, 1))
    model = boxes_mesh((*FOOT[:2], sides[0]), ((0.02, 0.02, 0.02), place, sides[1]))
    which = "the mesh" if sides == (-1, -1) else "a shell of the mesh"
    with pytest.warns(GranularWarning, match=f"^{which} of geom 'mesh' is inside out"):
        found = facets_from_model(model, [0])
    expected = facets_from_model(right, [0])
    assert found["area"].sum() == pytest.approx(expected["area"].sum(), rel=1e-3)
    assert volume(found) == pytest.approx(volume(expected), rel=1e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_shell_within_another_is_not_resisted(side):
    # A cavity is rightly inside out: no warning.
    model = boxes_mesh(FOOT, ((0.01, 0.01, 0.01), (0, 0.01, 0), side))
    found = facets_from_model(model, [0], sheltered="keep")
    assert found["area"].sum() == pytest.approx(6 * 0.06**2, rel=1e-5)


def test_shells_that_overlap_count_once():
    # Their floors are at one height.
    model = boxes_mesh(FOOT, ((0.03, 0.02, 0.02), (0.02, 0, -0.01), 1))
    found = facets_from_model(model, [0], 60, sheltered="keep")
    assert volume(found) == pytest.approx(0.06**3 + 0.02 * 0.04**2, rel=0.02)
    floor = found[found["normal"][:, 2] < -0.99]
    assert floor["area"].sum() == pytest.approx(0.06**2 + 0.02 * 0.04, rel=0.02)


@pytest.mark.parametrize("order", [1, -1])
def test_shells_that_touch_are_one(order):
    model = boxes_mesh(*(FOOT, ((0.02, 0.02, 0.01), (0, 0, -0.04), 1))[::order])
    found = facets_from_model(model, [0], 60, sheltered="keep")
    expected = 6 * 0.06**2 + 4 * 0.04 * 0.02
    assert found["area"].sum() == pytest.approx(expected, rel=0.01)


# Bad input


def test_mesh_without_faces():
    model = mesh_model(0.05 * CORNERS, SIDES)
    model.mesh_facenum[0] = 0  # MuJoCo would have made a hull
    with pytest.raises(InputError, match="'mesh' has no faces"):
        Sand(model, law=GENERIC)


def test_mesh_of_needles():
    model = mesh_model(0.05 * CORNERS, SIDES)
    model.mesh_vert[:, 1:] = 0
    with pytest.raises(InputError, match="no face with an area"):
        Sand(model, law=GENERIC)


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("sphere", 0.0),
        ("capsule", -0.01),
        ("cylinder", math.nan),
        ("ellipsoid", 0.0),
        ("brick", -0.01),
    ],
)
def test_geom_of_size_zero(name, bad):
    # MuJoCo refuses such a file; a program can still write one.
    model = body(geom(name))
    model.geom_size[0, 0] = bad
    with pytest.raises(InputError, match=f"'{name}' has a size of zero"):
        Sand(model, law=GENERIC)


@pytest.mark.filterwarnings("ignore:invalid value encountered in divide")
def test_capsule_without_a_side():
    model = body(geom("capsule"))
    model.geom_size[0, 1] = 0
    cut = facets_from_model(model, [0])
    assert np.isfinite(cut["normal"]).all()


def test_geom_without_an_end():
    model = body(geom("brick"))
    model.geom_type[0] = mujoco.mjtGeom.mjGEOM_PLANE
    with pytest.raises(InputError, match=r"is a plane: sand acts on capsules, spheres, .*meshes"):
        Sand(model, law=GENERIC)


@pytest.mark.parametrize("resolution", [1, 0, -3])
def test_resolution_is_at_least_two(resolution):
    with pytest.raises(InputError, match=f"at least 2, not {resolution}"):
        Sand(body(geom("sphere")), law=GENERIC, resolution=resolution)


@pytest.mark.slow
@pytest.mark.parametrize("resolution", [FINEST + 1, 10**9])
def test_resolution_is_at_most_what_fits_into_memory(resolution):
    with pytest.raises(InputError, match=f"at most {FINEST}, not {resolution}"):
        Sand(body(geom("capsule")), law=GENERIC, resolution=resolution)
    assert len(facets_from_model(body(geom("plate")), [0], FINEST)) > 10_000


# Which geoms

CREATURE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="trunk">
      <freejoint/>
      <geom name="trunk" type="box" size=".1 .1 .1"/>
      <geom name="paint" type="sphere" size=".2" contype="0" conaffinity="0" group="2"/>
      <body name="leg" pos="0 0 -.3">
        <joint/>
        <geom name="shin" type="capsule" size=".01 .1"/>
        <geom name="toe" type="sphere" size=".02" contype="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({}, {"trunk", "shin", "toe"}),
        ({"bodies": "leg"}, {"shin", "toe"}),
        ({"bodies": ["trunk"]}, {"trunk"}),
        ({"geoms": ["toe", "trunk"]}, {"trunk", "toe"}),
        ({"geoms": "paint"}, {"paint"}),  # asked for
        ({"bodies": "trunk", "geoms": "toe"}, {"trunk", "toe"}),
    ],
)
def test_selection(chosen, expected):
    sand = Sand(mujoco.MjModel.from_xml_string(CREATURE), law=GENERIC, **chosen)
    found = {sand.model.geom(int(i)).name for i in np.unique(sand.elements["geom"])}
    assert found == expected
    # Body by body, each with a row of its own.
    slots = sand.elements["slot"]
    assert (np.diff(slots) >= 0).all()
    assert len(np.unique(slots)) == len(np.unique(sand.elements["body"]))


def test_elements_can_be_looked_at():
    sand = Sand(mujoco.MjModel.from_xml_string(CREATURE), law=GENERIC)
    elements = sand.elements
    assert {"geom", "body", "point", "normal", "area", "width"} <= set(elements.dtype.names)
    with pytest.raises(ValueError, match="read-only"):
        elements["area"] = 1


@pytest.mark.parametrize(
    ("name", "width"),
    [("sphere", 0.1), ("needle", 0.01), ("disc", 0.1), ("ellipsoid", 0.08), ("plate", 0.1)],
)
def test_width_is_the_middle_extent(name, width):
    assert facets(name)["width"] == pytest.approx(width)


# Pull over load of the wheel of docs/shapes.md, and of one 42 cm wide, by slip and resolution.
PULLS = {
    (0.03, 0.0): {4: -0.109, None: -0.105, 24: -0.102},
    (0.03, 0.5): {4: 0.155, None: 0.153, 24: 0.150},
    (0.03, 0.9): {4: 0.089, None: 0.089, 24: 0.089},
    (0.21, 0.0): {4: -0.113, None: -0.111},  # -0.212 and -0.126 with the facets of a rod
    (0.21, 0.9): {4: 0.101, None: 0.098},  # 0.447 and 0.224
}


@pytest.mark.parametrize(("half", "slip"), PULLS)
def test_wheels_pull_alike_at_every_resolution(half, slip):
    load = half / 0.03 * 3 + 0.5  # [kg]
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="0.002" integrator="implicitfast"/>
      <worldbody><body pos="0 0 .1">
        <joint name="x" type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
        <inertial mass="{load - 0.5}" pos="0 0 0" diaginertia=".1 .1 .1"/>
        <body name="wheel"><joint name="spin" axis="0 1 0" armature=".01"/>
          <geom type="cylinder" size=".1 {half}" euler="90 0 0" mass=".5"/></body>
      </body></worldbody>
      <actuator><velocity joint="spin" kv="50"/><velocity joint="x" kv="1e4"/></actuator>
    </mujoco>""")
    for resolution, expected in PULLS[half, slip].items():
        data = mujoco.MjData(model)
        data.ctrl[:] = 5.0, 0.5 * (1 - slip)
        sand, pulls = Sand(model, medium="quikrete_medium", resolution=resolution), []
        for step in range(1000):
            sand.step(data)
            if step > 600:
                pulls.append(sand.report(data)["wheel"].force[0])
        assert np.mean(pulls) / (load * 9.81) == pytest.approx(expected, abs=0.01)


def hull_model(points):
    spec = mujoco.MjSpec()
    spec.add_mesh(name="mesh").uservert = np.asarray(points, float).ravel()
    kind = mujoco.mjtGeom.mjGEOM_MESH
    body = spec.worldbody.add_body()
    body.add_freejoint()
    body.add_geom(type=kind, meshname="mesh")
    return spec.compile()


def rings(sides, *rounds):
    angles = 2 * math.pi / sides * np.arange(sides)
    return [(r * math.cos(a), r * math.sin(a), z) for r, z in rounds for a in angles]


SPUN = {  # with how far the middle of a side is from a circle
    "wheel of 13": (rings(13, (0.1, -0.03), (0.1, 0.03)), 0.25),
    **{f"wheel of {n}": (rings(n, (0.1, -0.03), (0.1, 0.03)), 0.15) for n in (16, 18, 19, 24, 64)},
    "ball": (
        rings(24, *((0.05 * math.sin(a), 0.05 * math.cos(a)) for a in np.linspace(0, math.pi, 13))),
        0.1,
    ),
}


@pytest.mark.parametrize("name", SPUN)
def test_round_meshes_slide_along_themselves_as_they_spin(name):
    points, close = SPUN[name]
    found = facets_from_model(hull_model(points), [0])
    found = found[np.abs(found["normal"][:, 2]) < 0.3]
    speeds = np.cross((0, 0, 1), found["point"])
    turns = np.cross((0, 0, 1), found["normal"])
    hidden = np.einsum("nki,ni,nkj->nj", found["hides"], turns, found["edges"])
    off = np.linalg.norm(hidden - speeds, axis=1) / np.linalg.norm(speeds, axis=1)
    assert off.max() < close
    lead = np.abs((speeds * found["normal"]).sum(axis=1)) / np.linalg.norm(speeds, axis=1)
    assert lead.max() < close / 5


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_the_force_does_not_jump_where_skin_begins_to_slide(seed):
    ball = Pushed(body(geom("sphere")), "rft3d_dynamic added=0", 6)
    velocity, spin = np.random.default_rng(seed).normal(size=(2, 2, 3)) * [[[1]], [[20]]]
    ways = ((x @ velocity, x @ spin) for t in np.linspace(0, 1, 2001) for x in [[1 - t, t]])
    level = (1, 0, 0, 0)
    forces = np.array([ball.force((0, 0, -0.02), level, v, w) for v, w in ways])
    steps, sizes = (np.linalg.norm(x, axis=1) for x in (np.diff(forces, axis=0), forces))
    assert steps.max() < 0.005 * sizes.max()


def test_the_force_does_not_jump_where_skin_becomes_too_straight_to_slide():
    def lift(thick):
        geom = f"<geom type='ellipsoid' size='0.1 {thick} {thick}'/>"
        pushed = Pushed(body(geom), "rft3d_dynamic added=0")
        return pushed.force((0, 0, 0), (1, 0, 0, 0), (0.1, 0, 0), (0, 10, 0))[2]

    lifts = [lift(thick) for thick in np.geomspace(0.05, 0.0485, 7)]
    assert np.abs(np.diff(np.log(lifts))).max() < 0.02


def test_a_roller_is_one_that_turns_about_its_own_axis():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody>
      <body><joint axis="0 1 0"/><geom type="sphere" size=".01" pos="0 0 1"/>
        <body euler="90 0 0"><geom type="cylinder" size=".1 .25"/></body></body>
      <body><joint axis="0 0 1"/><geom type="cylinder" size=".1 .25" euler="90 0 0"/></body>
      <body><freejoint/><geom type="cylinder" size=".1 .25"/></body>
    </worldbody></mujoco>""")
    assert [len(facets_from_model(model, [geom])) for geom in (1, 2, 3)] == [324, 108, 108]


@pytest.mark.parametrize("resolution", [4, None])
@pytest.mark.parametrize("half", [0.02, 0.03])
def test_a_wheel_that_leans_does_not_fall_over(half, resolution):
    # With a single row of facets it fell; with 7 rows it leans by 2.7 and 2.1 degrees in the end.
    lean = math.radians(2)
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
      <body pos="0 0 .1" axisangle="1 0 0 {90 - math.degrees(lean)}"><freejoint/>
        <geom type="cylinder" size=".1 {half}" mass="4"/></body>
    </worldbody></mujoco>""")
    data, sand = mujoco.MjData(model), Sand(model, resolution=resolution)
    for _ in range(500):
        sand.step(data)
    assert abs(math.asin(data.xmat[1, 8])) < 1.5 * lean


@pytest.mark.parametrize("resolution", [4, None])
def test_a_wheel_is_steered_in_place_as_with_fine_facets(resolution):
    # 58 and 45 % less with a single row of facets.
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
      <body name="wheel" pos="0 0 .1"><joint type="slide" axis="0 0 1"/>
        <joint name="yaw" axis="0 0 1" armature=".1"/>
        <geom type="cylinder" size=".1 .03" euler="90 0 0" mass="4"/></body>
    </worldbody><actuator><velocity joint="yaw" kv="1e3"/></actuator></mujoco>""")
    data, sand = mujoco.MjData(model), Sand(model, resolution=resolution)
    data.ctrl[0], moments = 1.0, []
    for step in range(1000):
        sand.step(data)
        if step > 600:
            moments.append(sand.report(data)["wheel"].moment[2])
    fine = -0.58  # [N m], with resolution=96
    assert np.mean(moments) == pytest.approx(fine, rel=0.2)


ALL_ROUND = {
    "free": 'axis="0 1 0"',
    "two turns": 'axis="0 1 0" range="-720 720"',
    "half a turn each way": 'axis="0 1 0" range="-180 180"',
    "nearly": 'axis="0 1 0" range="-175 175"',
    "ball": 'type="ball"',
    "limited ball": 'type="ball" range="0 175"',
}


@pytest.mark.parametrize("joint", ALL_ROUND)
def test_a_fender_hides_nothing_of_a_wheel_that_turns(joint):
    # The upper part of the wheel is inside the chassis.
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><worldbody><body><freejoint/><geom type="box" size=".3 .2 .04" pos="0 0 .08"/>
      <body><joint {ALL_ROUND[joint]}/>
        <geom type="cylinder" size=".1 .03" euler="90 0 0"/></body>
    </body></worldbody></mujoco>""")
    wheel = facets_from_model(model, [1])["area"].sum()
    both = facets_from_model(model, [0, 1])
    assert both["area"][both["geom"] == 1].sum() == pytest.approx(wheel)


def test_skin_between_capsules_is_hidden_by_joints_that_turn_all_round():
    areas = []
    for joint in ('type="ball"', 'axis="0 1 0"', 'axis="0 1 0" range="-90 90"'):
        rod = 'geom type="capsule" size=".02" fromto="0 0 0 .1 0 0"/'
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody><body><freejoint/><{rod}>"
            f'<body pos=".1 0 0"><joint {joint}/><{rod}></body></body></worldbody></mujoco>'
        )
        areas.append(facets_from_model(model, [0, 1])["area"].sum())
    assert areas == pytest.approx([areas[-1]] * 3)


def test_what_stays_in_the_chassis_as_a_wheel_turns_is_hidden():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody><body><freejoint/><geom type="box" size=".3 .2 .1"/>
      <body><joint axis="0 1 0"/><geom type="cylinder" size=".05 .25" euler="90 0 0"/></body>
    </body></worldbody></mujoco>""")
    axle = facets_from_model(model, [0, 1])
    axle = axle[axle["geom"] == 1]
    assert np.abs(axle["point"][:, 1]).min() > 0.19
