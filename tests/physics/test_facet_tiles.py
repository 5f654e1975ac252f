"""Facets side by side: arithmetic in lanes, and that all is as it is one by one."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numba import njit

from mjgranular import Plane, Rft2dLaw, Rft3dLaw, Sand, media
from mjgranular.kernel.fields import rows
from mjgranular.kernel.lanes import LINE, aligned, choose, count_of

_two, _eight = rows(2, 4), rows(8, 4)
_read, _write = _two.read, _eight.write


@njit(error_model="numpy")
def calculated(numbers, results, x):
    a, b = _read(numbers, 0)
    inside = choose(a * b < 0.5, -a, x / b)
    chosen = choose(x > 1.0, a, b)  # one condition for all lanes
    _write(
        results,
        0,
        (a + b, a - x, 2 * a * b, a / b, abs(a), choose(a <= b, 1.0, b), inside, chosen),
    )
    return count_of(a > 0.0), count_of(b >= x)


def test_arithmetic_is_numpys():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.normal(size=(2, 4))
        x = rng.normal() + 1
        results = np.zeros(32)
        counts = calculated(np.concatenate([a, b]), results, x)
        expected = [
            a + b,
            a - x,
            2 * a * b,
            a / b,
            np.abs(a),
            np.where(a <= b, 1, b),
            np.where(a * b < 0.5, -a, x / b),
            a if x > 1 else b,
        ]
        np.testing.assert_array_equal(results.reshape(8, 4), expected)
        assert counts == ((a > 0).sum(), (b >= x).sum())


def test_no_number_is_in_no_order():
    results = np.zeros(32)
    a, b = np.array([np.nan, 1.0, 1.0, 0.0]), np.array([1.0, np.nan, 1.0, 1.0])
    assert calculated(np.concatenate([a, b]), results, 1.0) == (2, 3)
    np.testing.assert_array_equal(results.reshape(8, 4)[5], [1.0, np.nan, 1.0, 1.0])


def test_aligned():
    for size in (1, 7, 64, 1001):
        numbers = np.arange(float(size))
        copy = aligned(numbers)
        assert copy.ctypes.data % LINE == 0
        np.testing.assert_array_equal(copy, numbers)


BODIES = """
<mujoco>
  <option timestep="1e-4"/>
  <asset>
    <mesh name="gem" vertex="-.05 0 0 .06 0 .01 0 -.05 0 0 .07 0 .01 0 -.06 0 .01 .08"/>
  </asset>
  <worldbody>
    <body><freejoint/>
      <geom size=".03" mass=".1" pos=".05 0 .02"/><geom type="box" size=".04 .03 .02" mass=".2"/>
      <body pos="0 .1 0">
        <joint axis="1 2 .5"/><geom type="capsule" size=".02 .04" mass=".1"/>
      </body>
    </body>
    <body pos=".3 0 0"><freejoint/><geom type="ellipsoid" size=".03 .05 .04" mass=".1"/></body>
    <body pos="-.3 0 0"><freejoint/><geom type="mesh" mesh="gem" mass=".1"/></body>
    <body pos="0 0 2"><freejoint/><geom type="cylinder" size=".03 .05" mass=".1"/></body>
  </worldbody>
</mujoco>"""


class OneByOne(Plane):
    """A plane of which laws are not told that it is one."""

    is_plane = False


def thrown(model, rng):
    """A state with bodies in the sand, half in it and above it."""
    data = mujoco.MjData(model)
    for joint in range(model.njnt):
        first = model.jnt_qposadr[joint]
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[first + 2] += rng.uniform(-0.08, 0.06)
            data.qpos[first + 3 : first + 7] = rng.normal(size=4)
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:] = rng.normal(size=model.nv)
    return data


@pytest.mark.parametrize("law", [Rft3dLaw, Rft2dLaw])
@pytest.mark.parametrize(
    "options",
    [{}, {"inertia": 1.1}, {"rise": True, "inertia": 0.5}],
    ids=["plain", "fast", "wheel"],
)
def test_side_by_side_as_one_by_one(law, options):
    medium = media["quikrete_medium" if law is Rft3dLaw else "poppy_seed_loose"]
    model = mujoco.MjModel.from_xml_string(BODIES)
    place = {"height": 0.01, "slope": 0.15, "uphill": 0.7}
    sands = [
        Sand(
            model,
            medium=medium,
            law=replace(law.from_medium(medium), **options),
            surface=kind(**place),
            scheme="explicit",
            resolution=7,
        )
        for kind in (Plane, OneByOne)
    ]
    rng = np.random.default_rng(1)
    immersed = 0
    for _ in range(8):
        data = thrown(model, rng)
        one, other = (sand.report(data) for sand in sands)
        immersed += int((other.elements.depth > 0).sum())
        for name in ("depth", "point", "velocity", "force", "immersed_length"):
            found, expected = getattr(one.elements, name), getattr(other.elements, name)
            np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13, err_msg=name)
        for mine, theirs in zip(one.bodies, other.bodies, strict=True):
            np.testing.assert_allclose(mine.force, theirs.force, rtol=1e-11, atol=1e-13)
            np.testing.assert_allclose(mine.moment, theirs.moment, rtol=1e-11, atol=1e-13)
    assert immersed > 300


def test_both_schemes_see_the_same():
    model = mujoco.MjModel.from_xml_string(BODIES)
    sands = [
        Sand(model, medium="quikrete_medium", law="rft3d", scheme=scheme, resolution=7)
        for scheme in ("explicit", "implicit")
    ]
    rng = np.random.default_rng(2)
    for _ in range(4):
        data = thrown(model, rng)
        one, other = (sand.report(data).elements for sand in sands)
        for name in ("depth", "point", "immersed_length"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def test_tiles_hold_the_facets_in_their_order():
    model = mujoco.MjModel.from_xml_string(BODIES)
    sand = Sand(model, medium="quikrete_medium", law="rft3d", resolution=3)
    elements, kernel = sand.elements, sand.law.kernel(Plane())
    tiles, lanes = kernel.pack(elements), kernel.lanes
    assert tiles.shape[2] == lanes == 8
    counts = np.bincount(elements["slot"])
    assert len(tiles) == (-(-counts // lanes)).sum()
    first = 0
    for slot, count in enumerate(counts):
        mine = elements[elements["slot"] == slot]
        here = tiles[first : first + -(-count // lanes)].transpose(0, 2, 1).reshape(-1, 28)
        first += -(-count // lanes)
        np.testing.assert_array_equal(here[:count, :3], mine["point"])
        np.testing.assert_array_equal(here[:count, 3:6], mine["normal"])
        np.testing.assert_array_equal(here[:count, 6:12].reshape(-1, 2, 3), mine["edges"])
        np.testing.assert_array_equal(here[:count, 12:18].reshape(-1, 2, 3), mine["spread"])
        np.testing.assert_array_equal(here[:count, 18], mine["area"])
        np.testing.assert_array_equal(here[:count, 19], mine["face"])
        np.testing.assert_array_equal(here[:count, 20], mine["flat"])
        np.testing.assert_array_equal(here[:count, 21], mine["layer"])
        np.testing.assert_array_equal(here[:count, 22:].reshape(-1, 2, 3), mine["hides"])
        assert (here[count:] == here[count - 1]).all()  # lanes that are left over


@pytest.mark.parametrize("law", [Rft3dLaw.from_medium("quikrete_medium"), Rft2dLaw.generic(2.0)])
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
def test_each_element_counts_once(law, scheme):
    """Tiles are put together of what is in the sand: a body's wrench is the sum over its elements.

    An element that came into two tiles would act twice, and be reported once.
    """
    model = mujoco.MjModel.from_xml_string(
        """
        <mujoco>
          <option timestep="1e-3" integrator="implicitfast"/>
          <worldbody>
            <body><freejoint/>
              <geom type="box" size=".06 .04 .03"/>
              <geom type="ellipsoid" size=".05 .03 .02" pos=".08 0 0"/>
            </body>
          </worldbody>
        </mujoco>
        """
    )
    sand, data = Sand(model, law=law, scheme=scheme), mujoco.MjData(model)
    rng = np.random.default_rng(1)
    immersed = set()
    for _ in range(40):
        data.qpos[2] = rng.uniform(-0.06, 0.03)
        data.qpos[3:7] = rng.normal(size=4)
        data.qvel[:] = rng.normal(size=6)
        mujoco.mj_forward(model, data)
        report = sand.report(data)
        table, body = report.elements, report.bodies[0]
        arms = table.point - data.xipos[1]
        assert table.force.sum(0) == pytest.approx(body.force, rel=1e-9, abs=1e-9)
        assert np.cross(arms, table.force).sum(0) == pytest.approx(body.moment, rel=1e-9, abs=1e-9)
        immersed.add(int((table.depth > 0).sum()) % 8)
    assert len(immersed) > 4  # tiles that are full, and not


def test_a_normal_that_is_upright_but_for_rounding():
    # Cosines of 1e-221, the products of which are nothing.
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom type='capsule' size='.1 .3'/></body>"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[2:7] = [-0.5, 0, 0, 1, 7e-221]
    data.qvel[2] = 1.0  # it turns a half about y: its axis is upright
    for scheme in ("explicit", "implicit"):
        report = Sand(model, law="rft3d", medium="quikrete_medium", scheme=scheme).report(data)
        assert np.isfinite(report.elements.force).all()
        assert report.bodies[0].force[2] < 0
