"""Stagnant sand, friction by rate of shear, the laws that have all of it: closed forms, rest."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjgranular import DynamicRft2dLaw, DynamicRft3dLaw, InputError, Rft3dLaw, Sand, add_sand
from mjgranular.calibrate import compare, read_runs, simulate
from mjgranular.law.raised import INERTIAL_NUMBER, RATE, cone_under
from mjgranular.scheme import Explicit
from mjgranular.shape import facets_from_model

pytestmark = pytest.mark.slow  # programs of their own

PLAIN = Rft3dLaw(1500.0, 0.4, 0.3)
SIDE, G = 0.04, 9.81
LED = Explicit(prescribed=True)
DATA = Path(__file__).parents[2] / "referee" / "data"


def plate(depth, velocity, tilt=0.0):
    """A square plate whose lower face is so deep in its middle, and its model."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="1e-3"/><worldbody><body name="plate"><freejoint/>
        <geom type="box" size="{SIDE / 2} {SIDE / 2} 0.01" mass="0.3"/></body></worldbody></mujoco>
        """
    )
    data = mujoco.MjData(model)
    data.qpos[2] = 0.01 - depth
    data.qpos[3:] = math.cos(tilt / 2), 0, math.sin(tilt / 2), 0
    data.qvel[:3] = velocity
    return model, data


def lift(law, depth, velocity, **options):
    model, data = plate(depth, velocity, **options)
    return Sand(model, law=law, scheme=LED).report(data)["plate"].force[2]


@pytest.mark.parametrize("depth", [0.002, 0.004, 0.01, 0.05])
def test_a_level_plate_meets_the_cone_below_it(depth):
    # Force over depth of the plain law, at the depth of the cone's mean: it grows with the depth
    # over a tenth of the width.
    cone = cone_under(0.4)
    plain = lift(PLAIN, depth, (0, 0, -1e-3))
    found = lift(replace(PLAIN, cone=cone), depth, (0, 0, -1e-3))
    deeper = depth + cone * SIDE * min(depth / (0.1 * SIDE), 1.0)
    assert found == pytest.approx(plain * deeper / depth, rel=1e-9)


def test_the_cone_is_that_of_terzaghi():
    # The volume of a cone of the slope 45 degrees + phi/2 on a disc, over the disc.
    phi, radius = math.radians(30), 0.5  # of a width of one
    height = radius * math.tan(math.pi / 4 + phi / 2)
    assert cone_under(math.tan(phi)) == pytest.approx(height / 3, rel=1e-12)


def test_only_flat_faces_that_are_pushed_down_have_a_cone():
    coned = replace(PLAIN, cone=0.25)
    for velocity in ((0, 0, 1e-3), (1e-3, 0, 0)):  # out of the sand, along itself
        assert lift(coned, 0.05, velocity) == pytest.approx(lift(PLAIN, 0.05, velocity), rel=1e-9)
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='ball' pos='0 0 -0.1'><freejoint/><geom size='0.03'/></body>"
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[2] = -1e-3
    one, other = (
        Sand(model, law=law, scheme=LED).report(data)["ball"].force for law in (PLAIN, coned)
    )
    np.testing.assert_allclose(one, other, rtol=1e-12)


def box_and_ball_meshes():
    """A box as twelve triangles and a ball as many, as assets of one model."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.05
    n = 800
    i = np.arange(n) + 0.5
    polar, around = np.arccos(1 - 2 * i / n), math.pi * (1 + 5**0.5) * i
    ball = 0.05 * np.stack(
        [np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], 1
    )
    spec = mujoco.MjSpec()
    for name, points in (("box", corners), ("ball", ball)):
        mesh = spec.add_mesh(name=name)
        mesh.uservert = points.ravel()
        body = spec.worldbody.add_body(name=name)
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)
    return spec.compile()


@pytest.mark.parametrize("resolution", [6, 12, 24])
def test_meshes_are_flat_where_they_show_a_flat_face(resolution):
    facets = facets_from_model(box_and_ball_meshes(), [0, 1], resolution)
    box, ball = facets[facets["geom"] == 0], facets[facets["geom"] == 1]
    np.testing.assert_allclose(box["flat"], 1.0, atol=1e-6)
    assert ball["flat"].max() < 0.12  # patches of a coarse one turn by 15 degrees
    assert np.average(ball["flat"], weights=ball["area"]) < 0.08


@pytest.mark.parametrize(("speed", "depth"), [(0.02, 0.02), (0.3, 0.02), (3.0, 0.05)])
def test_friction_grows_with_the_inertial_number(speed, depth):
    # mu(I) of Jop, Forterre and Pouliquen, and the law's own stiffness at that friction.
    grain = 0.002
    law = replace(PLAIN, rate=RATE, grain=grain)
    stress = PLAIN.stiffness * G * depth
    number = speed / SIDE * grain * math.sqrt(PLAIN.density / 0.59 / stress)
    mu = 0.4 + RATE * number / (number + INERTIAL_NUMBER)
    stiffer = replace(PLAIN, internal_friction=mu).stiffness / PLAIN.stiffness
    slow, fast = (lift(each, depth, (0, 0, -speed)) for each in (PLAIN, law))
    assert fast == pytest.approx(slow * stiffer, rel=1e-9)


def test_slow_motion_is_quasi_static():
    law = replace(
        DynamicRft3dLaw.from_medium("quikrete_medium"), grain=5e-4, cone=0.0, scale=1.0, lateral=0.0
    )
    slow = Rft3dLaw.from_medium("quikrete_medium")
    for velocity in ((0, 0, -1e-5), (1e-5, 0, -2e-5)):
        assert lift(law, 0.02, velocity) == pytest.approx(lift(slow, 0.02, velocity), rel=2e-4)


@pytest.mark.parametrize("law", ["rft3d_dynamic", "rft2d_dynamic"])
@pytest.mark.parametrize(("medium", "repose"), [("poppy_seed_loose", 36), ("poppy_seed_close", 47)])
def test_a_medium_of_the_slow_law_serves(law, medium, repose):
    model, data = plate(0.01, (0, 0, -0.2))
    sand = Sand(model, medium=medium, law=law)
    assert sand.scheme.name == "implicit"  # at any time step: sand is moved along
    assert sand.law.added == 2.5
    friction = math.tan(math.radians(repose)) if law == "rft3d_dynamic" else 0.6
    assert sand.law.cone == pytest.approx(cone_under(friction))
    before = sand.report(data)["plate"].force[2]
    assert 0 < before < 1e3


def test_a_plate_as_deep_as_wide_is_as_the_medium_has_it():
    slow, law = (kind.from_medium("quikrete_medium") for kind in (Rft3dLaw, DynamicRft3dLaw))
    there = (0, 0, -1e-6)
    assert lift(law, SIDE, there) == pytest.approx(lift(slow, SIDE, there), rel=1e-3)


@pytest.mark.parametrize("timestep", [1e-3, 1e-2])
@pytest.mark.parametrize("law", ["rft3d_dynamic", "rft2d_dynamic"])
def test_rest_is_exact(law, timestep):
    model, data = plate(0.0, (0.2, 0.1, -0.8), tilt=0.2)
    model.opt.timestep = timestep
    sand = Sand(model, medium="poppy_seed_loose", law=law)
    while data.time < 1.5:
        sand.step(data)
    at = data.qpos.copy()
    while data.time < 3.0:
        sand.step(data)
    assert np.abs(data.qpos - at).max() < 1e-8


@pytest.mark.parametrize("timestep", [2e-4, 1e-3, 4e-3, 1e-2])
@pytest.mark.parametrize("law", [DynamicRft3dLaw, DynamicRft2dLaw])
def test_the_sand_takes_energy_and_gives_none(work_given, law, timestep):
    law = law.from_medium("poppy_seed_loose")
    model, data = plate(0.03, (0.0, 0.0, 0.0))
    model.opt.timestep = timestep
    sand = Sand(model, law=law)
    for seed in range(8):
        mujoco.mj_resetData(model, data)
        data.qpos[2] = -0.03
        given, put = work_given(sand, model, data, steps=60, seed=seed)
        assert given <= 1e-9 * put


def test_both_interfaces_go_on_alike():
    options = {"medium": "poppy_seed_loose", "law": "rft3d_dynamic"}
    model, data = plate(0.0, (0.1, 0, -0.5))
    sand = Sand(model, **options)
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="plate")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[SIDE / 2, SIDE / 2, 0.01], mass=0.3)
    spec.option.timestep = 1e-3
    add_sand(spec, **options)
    within = spec.compile()
    theirs = mujoco.MjData(within)
    theirs.qpos[:], theirs.qvel[:] = data.qpos, data.qvel
    for _ in range(200):
        sand.step(data)
        mujoco.mj_step(within, theirs)
    np.testing.assert_allclose(data.qpos, theirs.qpos, atol=1e-10)


@pytest.mark.parametrize("key", ["cone", "rate", "grain"])
@pytest.mark.parametrize("bad", [-1.0, math.nan, "2"])
def test_what_is_no_number_from_zero_is_refused(key, bad):
    with pytest.raises(InputError, match=key):
        replace(PLAIN, **{key: bad})


BLIND = ("flat foot of 26 mm 0.7 m/s", "sphere of 30 mm 1 m/s", "rod at 20 deg 1 m/s")


@pytest.mark.parametrize("name", BLIND)
def test_drops_that_nobody_had_seen(name):
    """Simulated grains that were let flow after the law was written down."""
    runs = read_runs(DATA / "tilted")
    law = DynamicRft3dLaw.from_medium(runs.medium)
    push = runs["level"]  # the strength is of a slow push of a plate; nothing else is free
    force = simulate(push, runs.medium, law).force
    scale = float((push.motion.force * force).sum() / (force * force).sum())
    law = replace(law, scale=scale * law.scale)
    errors = compare(runs[name].motion, simulate(runs[name], runs.medium, law))
    assert errors.trajectory < 0.07
    assert abs(errors.final) < 0.09
    assert abs(errors.stopping_time) < 0.15
    assert errors.pitch is None or abs(errors.pitch) < 10


PUSHED = {"tilted 30": 0.1, "tilted 45": 0.1, "tilted 60": 0.1, "tilted 75": 0.2, "rod 30": 0.2}


@pytest.mark.parametrize("name", PUSHED)
def test_tilted_bodies_meet_the_force_of_simulated_grains(name):
    runs = read_runs(DATA / "tilted")
    law, ratio = DynamicRft3dLaw.from_medium(runs.medium), []
    for run in (runs["level"], runs[name]):
        found, measured = simulate(run, runs.medium, law).force, run.motion.force
        deep = run.motion.depth > 0.005
        ratio.append((found * measured)[deep].sum() / (measured * measured)[deep].sum())
    assert ratio[1] / ratio[0] == pytest.approx(1.0, abs=PUSHED[name])


# Law over grains, relative to a push straight down: up and against the motion; docs/laws/rft.md.
OBLIQUE = {34: (1.08, 1.16), 18: (1.16, 1.02), 10: (1.56, 0.95)}


@pytest.mark.parametrize("course", OBLIQUE)
def test_plates_pushed_obliquely_meet_the_force_of_simulated_grains(course):
    runs = read_runs(DATA / "tilted")
    law, ratios = DynamicRft3dLaw.from_medium(runs.medium), []
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="b"><freejoint/><geom type="box" size=".01 .01 .0025" '
        'mass="1e5"/></body></worldbody></mujoco>'
    )
    sand, data = Sand(model, medium=runs.medium, law=law), mujoco.MjData(model)
    for file, angle in (
        (DATA / "tilted/tilt0.csv", 90),
        (f"{DATA}/oblique/course{course}.csv", course),
    ):
        rows = np.genfromtxt(file, delimiter=",", names=True)
        rows = rows[(rows["depth_m"] > 0.004) & (rows["depth_m"] <= 0.012)]
        across, down = 0.2 * math.cos(math.radians(angle)), 0.2 * math.sin(math.radians(angle))
        found = []
        for depth in rows["depth_m"]:
            data.qpos[2], data.qvel[:3] = 0.0025 - depth, (across, 0.0, -down)
            found.append(sand.report(data)["b"].force)
        x, _, z = np.mean(found, axis=0)
        ratios.append(z / rows["force_N"].mean())
    found = ratios[1] / ratios[0], -x / rows["drag_N"].mean() / ratios[0]
    assert found == pytest.approx(OBLIQUE[course], abs=0.03)


def test_limits_say_how_fast_it_was_confirmed():
    (froude,) = (limit for limit in DynamicRft3dLaw.validity if limit.measure == "froude")
    assert froude.most > 2
    assert "docs/validity.md" in froude.source
    assert DynamicRft2dLaw.validity[0].most < froude.most


def test_strength_can_be_free_in_a_fit():
    from mjgranular.calibrate.material import Material

    medium = read_runs(DATA / "wide_bed").medium  # with a grain size
    for law in ("rft3d", "rft3d_dynamic"):
        material = Material.of(medium, law)
        assert "strength" in material.names
        stronger = material.changed({"strength": 1.5}).law
        assert stronger.scale == pytest.approx(1.5 * material.law.scale)
