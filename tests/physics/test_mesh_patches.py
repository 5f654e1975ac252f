"""Patches of meshes: the divergence theorem, invariance, and forces against all triangles."""

from __future__ import annotations

import math
from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjgranular import Explicit, Rft3dLaw, Sand, media
from mjgranular.shape import facets_from_model, patches
from mjgranular.shape.sizes import FACETS
from mjgranular.shape.tessellation import Facets

pytestmark = [
    pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning"),
    pytest.mark.filterwarnings("ignore::mjgranular.errors.CostWarning"),
]
QUIKRETE = Rft3dLaw.from_medium(media["quikrete_medium"])


def ball(count):
    """Vertices and faces of a unit ball: `count` rings of twice as many quadrangles."""
    u, v = np.meshgrid(np.arange(1, count), np.arange(2 * count), indexing="ij")
    polar, turn = math.pi * u / count, math.pi * v / count
    rim = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    vertices = np.concatenate([rim.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    around = 2 * count
    index = np.arange((count - 1) * around).reshape(count - 1, around)
    after = np.roll(index, -1, axis=1)
    top, bottom = len(vertices) - 2, len(vertices) - 1
    a, b, c, d = index[:-1], index[1:], after[1:], after[:-1]
    faces = [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    faces.append(np.stack([np.full(around, top), index[0], after[0]], -1))
    faces.append(np.stack([np.full(around, bottom), after[-1], index[-1]], -1))
    return vertices, np.concatenate(faces)


def lump(seed, count=20, size=(1.0, 1.0, 1.0), rough=0.3):
    """A closed body without symmetry: a ball with bumps, pressed to half sizes. Corners [m]."""
    vertices, faces = ball(count)
    rng = np.random.default_rng(seed)
    radius = np.ones(len(vertices))
    for _ in range(12):
        toward = rng.normal(size=3)
        toward /= np.linalg.norm(toward)
        radius += rough * rng.uniform(-0.5, 1) * np.exp(-8 * (1 - vertices @ toward))
    return (vertices * radius[:, None] * size)[faces]


def foot(count=72):
    """A foot of 20 448 triangles, 0.2 m long: a rounded block with a profile of 2 mm under it."""
    vertices, faces = ball(count)
    rounded = np.sign(vertices) * np.abs(vertices) ** 0.35
    vertices = rounded * [0.1, 0.04, 0.02]
    below = vertices[:, 2] < -0.01
    vertices[below, 2] += 0.002 * np.sign(np.sin(vertices[below, 0] * 2 * math.pi / 0.03))
    return vertices[faces]


def volume_of(corners):
    return np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6


def moments_of(facets):
    """The integral of x n dA of patches, shape (3, 3): the identity times the volume if closed."""
    at, normal, area = facets.points, facets.normals, facets.areas
    inner = np.einsum("nki,nkj->nij", facets.edges, facets.spread) / 3
    return ((at[:, :, None] * normal[:, None] + inner) * area[:, None, None]).sum(axis=0)


def cut(corners, resolution):
    pieces, _ = patches.pieces(corners, resolution)
    flat = np.zeros((len(pieces), 3, 3))
    return patches.gathered(pieces, resolution, flat, flat[:, 0])[0]


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.tuples(*[st.floats(-1.5, 0.5).map(lambda x: 10**x)] * 3),
    place=st.tuples(*[st.floats(-3, 3)] * 3),
    resolution=st.integers(4, 30),
)
def test_closed_meshes_stay_closed(seed, size, place, resolution):
    corners = lump(seed, 12, size) + place
    facets = cut(corners, resolution)
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    skin = np.linalg.norm(vectors, axis=1).sum()
    assert len(facets) <= 2 * resolution**2
    leak = (facets.areas[:, None] * facets.normals).sum(axis=0)
    assert np.abs(leak).max() < 1e-12 * skin
    assert facets.areas.sum() <= skin * (1 + 1e-12)
    assert facets.areas.sum() > skin * (1 - 8 / resolution**2)
    middle = (facets.areas @ facets.points) / facets.areas.sum() - place
    assert np.abs(middle).max() < 5 * max(size)
    # Lifted as by a liquid, whichever way is up, and not turned into another direction.
    away = facets.points - place
    lift = moments_of(Facets(away, *[getattr(facets, k) for k in FIELDS]))
    error = np.abs(lift - volume_of(corners - place) * np.eye(3)).max()
    assert error < 0.6 / resolution * skin * max(size) / 3


FIELDS = ("normals", "areas", "edges", "spread", "skin")


def test_volume_converges():
    corners = lump(3, 40)
    true = volume_of(corners)
    errors = [
        np.abs(moments_of(cut(corners, resolution)) - true * np.eye(3)).max() / true
        for resolution in (6, 12, 24)
    ]
    assert errors[1] < 0.01
    assert errors[2] < 0.3 * errors[0]


@pytest.mark.parametrize("resolution", [4, 12])
def test_both_sides_of_a_plate_stay_apart(resolution):
    vertices, faces = ball(40)
    corners = (np.sign(vertices) * np.abs(vertices) ** 0.2 * [0.1, 0.1, 0.0005])[faces]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    shadow = np.abs(vectors[:, 2]).sum() / 2
    facets = cut(corners, resolution)
    above = facets.normals[:, 2] > 0
    for side in (above, ~above):
        found = facets.areas[side] @ np.abs(facets.normals[side, 2])
        assert found == pytest.approx(shadow, rel=1e-3)


def test_turned_meshes_make_turned_patches():
    corners = lump(1, 16, (1.0, 0.6, 0.3))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([0.5, -0.1, 0.7, 0.5]))
    turn = np.linalg.qr(turn.reshape(3, 3))[0]
    turn *= np.linalg.det(turn)
    still, turned = cut(corners, 10), cut(corners @ turn.T, 10)
    assert len(still) == len(turned)
    # Which half of a patch comes first is a matter of rounding.
    first, second = np.argsort(still.areas), np.argsort(turned.areas)
    np.testing.assert_allclose(turned.areas[second], still.areas[first], rtol=1e-9)
    np.testing.assert_allclose(turned.points[second], still.points[first] @ turn.T, atol=1e-9)
    np.testing.assert_allclose(turned.normals[second], still.normals[first] @ turn.T, atol=1e-9)


def test_scale_does_not_matter():
    corners = lump(2, 10)
    one = cut(corners, 8)
    for scale in (1e-9, 1e9):
        other = cut(scale * corners, 8)
        np.testing.assert_allclose(other.points, scale * one.points, rtol=1e-6, atol=1e-6 * scale)
        np.testing.assert_allclose(other.areas, scale**2 * one.areas, rtol=1e-6)


def test_a_thorn_makes_no_host_of_pieces():
    corners = lump(2, 6)
    tip = corners[0].copy()
    tip[0] += [1e6, 0, 0]
    assert len(patches.pieces(np.concatenate([corners, tip[None]]), 12)[0]) < 1000


@pytest.mark.parametrize("sides", [[[0, 1, 2]], [[0, 1, 2], [0, 2, 1]]])
def test_what_has_no_direction_is_no_patch(sides):
    corners = np.eye(3)[np.array(sides)]
    facets = cut(corners, 4)
    assert np.isfinite(facets.points).all()
    assert np.isfinite(facets.spread).all()
    total = (facets.areas[:, None] * facets.normals).sum(axis=0)
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0) / 2
    np.testing.assert_allclose(total, vectors, atol=1e-12)


def model_of(*bodies, shift=0.0):
    """Free bodies, each of one mesh; corners of each, shape (n, 3, 3)."""
    spec = mujoco.MjSpec()
    for k, corners in enumerate(bodies):
        vertices, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        mesh = spec.add_mesh(name=f"mesh {k}")
        mesh.uservert, mesh.userface = vertices.ravel(), faces.ravel()
        body = spec.worldbody.add_body(name=f"body {k}", pos=[k * shift, 0, 0])
        body.add_freejoint()
        body.mass, body.inertia, body.explicitinertial = 1.0, [1, 1, 1], True
        body.add_geom(name=f"geom {k}", type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh {k}")
    return spec.compile()


class Fine(Rft3dLaw):
    """The law on all triangles of a mesh, none of them larger than the finest patches."""

    def elements(self, model, geoms, resolution=None):
        return facets_from_model(model, geoms, sheltered="keep", meshes="triangles")


class Patches(Rft3dLaw):
    """The law on patches, without the shelter that is not cut alike."""

    def elements(self, model, geoms, resolution=None):
        return facets_from_model(model, geoms, resolution, sheltered="keep")


FINE, PATCHES = Fine(**vars(QUIKRETE)), Patches(**vars(QUIKRETE))


def wrenches(model, law, states, resolution=None):
    """Force [N] and moment [N m] on the first body in each state."""
    sand = Sand(model, law=law, resolution=resolution, scheme=Explicit(half_step=False))
    data, found = mujoco.MjData(model), []
    for qpos, qvel in states:
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        data.xfrc_applied[:] = 0
        sand.apply(data)
        found.append(data.xfrc_applied[1].copy())
    return np.array(found)


def drawn_states(corners, count, seed=0):
    """Poses from a seventh in the sand to all of it, motions with some turning."""
    rng = np.random.default_rng(seed)
    points = corners.reshape(-1, 3)
    far = np.linalg.norm(points, axis=1).max()
    for _ in range(count):
        turn, quaternion = np.zeros(9), rng.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        mujoco.mju_quat2Mat(turn, quaternion)
        heights = points @ turn.reshape(3, 3)[2]
        depth = rng.uniform(0.15, 1.3) * np.ptp(heights)
        velocity, spin = rng.normal(size=(2, 3))
        speed = rng.uniform(0.05, 0.5)
        velocity *= speed / np.linalg.norm(velocity)
        spin *= speed / far / np.linalg.norm(spin)
        yield [0, 0, -heights.min() - depth, *quaternion], [*velocity, *spin]


BODIES = {
    "lump": lambda: lump(5, 60, (0.05, 0.04, 0.03)),
    "flat": lambda: lump(6, 60, (0.1, 0.04, 0.01)),
    "foot": foot,
}


@cache
def on_all_triangles(name, count=40):
    """Corners and model of a body, drawn states, and the wrenches of all its triangles in them."""
    corners = BODIES[name]()
    states, model = list(drawn_states(corners, count)), model_of(corners)
    return corners, model, states, wrenches(model, FINE, states)


def errors(name, resolution):
    """Errors of forces, and of moments as shares of force times reach."""
    corners, model, states, true = on_all_triangles(name)
    found = wrenches(model, PATCHES, states, resolution)
    size = np.linalg.norm(true[:, :3], axis=1)
    kept = size > 0.05 * np.median(size)
    reach = np.linalg.norm(corners.reshape(-1, 3), axis=1).max()
    off = np.linalg.norm(found[:, :3] - true[:, :3], axis=1)
    turned = np.linalg.norm(found[:, 3:] - true[:, 3:], axis=1)
    return off[kept] / size[kept], turned[kept] / (size[kept] * reach)


@pytest.mark.parametrize("name", BODIES)
def test_forces_are_within_five_percent_of_those_on_all_triangles(name):
    force, moment = errors(name, None)
    assert np.median(force) < 0.015
    assert np.quantile(force, 0.95) < 0.05
    assert np.quantile(moment, 0.95) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lump", "foot"])
def test_forces_converge_with_the_resolution(name):
    coarse, middle, fine = (np.median(errors(name, n)[0]) for n in (6, 12, 24))
    assert fine < middle < coarse
    assert math.log2(coarse / fine) / 2 > 1


def test_resolution_applies_to_meshes():
    model = model_of(foot(30))
    counts = [len(facets_from_model(model, [0], n)) for n in (4, 8, 16)]
    assert counts[0] <= 32 < counts[1] <= 128 < counts[2] <= 512


def test_many_meshes_share_the_facets_by_their_skins():
    sizes = [0.3, *[0.1] * 20, *[0.02] * 20]
    twin = 0.1 * 1.0001  # of a right arm, that differs from the left
    model = model_of(*(lump(0, 8, (s, s, s)) for s in [*sizes, twin]), shift=1.0)
    geoms = range(model.ngeom)
    found = facets_from_model(model, geoms)
    assert 0.6 * FACETS < len(found) < 1.02 * FACETS
    counts = np.bincount(found["geom"])
    assert counts[0] == len(facets_from_model(model, [0]))
    assert counts[1] > counts[-2]
    assert counts[1] == pytest.approx(counts[-1], rel=0.05)
    asked = facets_from_model(model, geoms, 12)
    assert len(asked) > 2 * len(found)


def wheel(sides):
    """A wheel 160 mm in diameter and 60 mm wide, its axis along y; a cylinder without `sides`."""
    turns = np.arange(sides or 3) * 2 * math.pi / (sides or 3)
    rim = [
        (0.08 * math.cos(turn), 0.08 * math.sin(turn), z) for z in (-0.03, 0.03) for turn in turns
    ]
    vertices = " ".join(f"{value:.9g}" for point in rim for value in point)
    shape = 'type="mesh" mesh="wheel"' if sides else 'type="cylinder" size=".08 .03"'
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><mesh name="wheel" vertex="{vertices}"/></asset><worldbody><body>
        <freejoint/><geom {shape} euler="90 0 0" mass="1"/></body></worldbody></mujoco>"""
    )


def force_on_wheel(model, velocity):
    data = mujoco.MjData(model)
    data.qpos[2], data.qvel[:] = 0.068, velocity
    mujoco.mj_forward(model, data)
    return Sand(model, resolution=24).report(data)[1].force


@pytest.mark.parametrize("sides", [24, 48, 192])
@pytest.mark.parametrize(
    "velocity",
    [(0.05, 0, 0, 0, 0.625, 0), (0.05, 0, 0, 0, 0, 0), (0, 0.05, 0, 0, 0, 0), (0, 0, -1, 0, 0, 0)],
    ids=["rolls", "slides", "slides sideways", "falls"],
)
def test_a_wheel_of_a_mesh_is_a_cylinder(sides, velocity):
    cylinder, mesh = (force_on_wheel(wheel(count), velocity) for count in (0, sides))
    assert np.linalg.norm(mesh - cylinder) < 0.06 * np.linalg.norm(cylinder)
