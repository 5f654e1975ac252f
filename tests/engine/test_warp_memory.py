"""Sand that remembers in MuJoCo Warp, on its CPU back end."""

import math

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, HeightField, InputError, Memory, Plane, Sand
from mjgranular.relief.grid import PRESSED

pytestmark = pytest.mark.slow
mjw = pytest.importorskip("mujoco_warp")

CELL = 0.01
MEMORY = Memory(cell=CELL)
SCENE = """
<mujoco>
  <option timestep="0.002" integrator="discrete"/>
  <asset><hfield name="dunes" nrow="9" ncol="9" size="0.8 0.8 0.05 0.1"/></asset>
  <worldbody>
    <geom name="dunes" type="hfield" hfield="dunes"/>
    <geom name="tray" type="box" size="0.09 0.5 0.1" pos="0 0 -0.1"/>
    <body name="box" pos="0 0 0.06">
      <freejoint/><geom type="box" size="0.05 0.04 0.03" mass="1.5"/>
    </body>
    <body name="ball" pos="0 0.3 0.06">
      <freejoint/><geom type="sphere" size="0.03" mass="0.3"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def warp():
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from mjgranular import warp as sand_for_warp

    return sand_for_warp


class Worlds:
    """The scene in worlds of MuJoCo Warp, and once on the processor."""

    def __init__(self, warp, count=2, surface=None, memory=MEMORY, **velocity):
        spec = mujoco.MjSpec.from_string(SCENE)
        spec.hfield("dunes").userdata = 0.5 + 0.1 * np.random.default_rng(0).random(81)
        # Nothing but sand holds them.
        for geom in spec.geoms:
            geom.contype, geom.conaffinity = int(not geom.name), 0
        self.model = warp.coupled(spec).compile()
        there = warp.coupled(spec).compile()
        self.data = mujoco.MjData(there)
        self.data.qvel[:] = [*velocity.get("box", (0, 0, -0.5)), 0, 0, 0, 0, 0, -0.5, 0, 0, 0]
        if isinstance(surface, HeightField):
            self.data.qpos[[2, 9]] += 0.03
        fields = {"surface": surface or Plane(), "memory": memory}
        self.sand = warp.WarpSand(self.model, corrections=6, **fields)
        self.m = mjw.put_model(self.model)
        self.d = mjw.put_data(self.model, self.data, nworld=count)
        self.sand.attach(self.m, self.d)
        self.on_processor = Sand(there, **fields)

    def step(self, count, *, both=False):
        for _ in range(count):
            mjw.step(self.m, self.d)
            if both:
                self.on_processor.step(self.data)

    def raised(self, by):
        """Where both bodies start, raised [m]."""
        qpos = mujoco.MjData(self.model).qpos
        qpos[[2, 9]] += by
        return qpos

    def put(self, world, **fields):
        for name, value in fields.items():
            values = getattr(self.d, name).numpy()
            values[world] = value
            getattr(self.d, name).assign(values)

    def heights(self, world=0, middle=(0.0, 0.0)):
        return self.sand.relief(self.d, world, middle).height

    def check_books(self):
        """What is nowhere in the heights is waiting or forgotten; nothing else is lost."""
        found = self.sand.volumes()
        assert (found["pressed"] > 1e-5).all()
        np.testing.assert_allclose(found["heaped"] + found["waiting"], found["pressed"], rtol=1e-4)
        return found


SURFACES = {
    "plane": Plane(),
    "slope": Plane(slope=0.3, uphill=0.7, height=0.01),
    "bed": Bed("tray"),
    "dunes": HeightField("dunes"),
}


@pytest.mark.parametrize("surface", SURFACES)
def test_prints_are_those_of_the_processor(warp, surface):
    """A box that slides and a ball: the order in which sand is moved is all that differs."""
    worlds = Worlds(warp, surface=SURFACES[surface], box=(0.3, 0.1, -0.5))
    worlds.step(120, both=True)
    poses = worlds.d.qpos.numpy()
    np.testing.assert_array_equal(poses[0], poses[1])
    np.testing.assert_allclose(poses[0], worlds.data.qpos, atol=2e-3)
    mine = worlds.heights()
    right = worlds.on_processor.relief(worlds.data, (0.0, 0.0)).height
    assert right.min() < -0.005
    assert right.max() > 0.005
    # A row of nodes at the edge of the box may be under it here, and beside it there.
    assert np.abs(mine - right).sum() < 0.2 * np.abs(right).sum()
    assert mine.min() == pytest.approx(right.min(), rel=0.02)
    found = worlds.check_books()
    pressed = worlds.on_processor.save_memory(worlds.data)[PRESSED]
    assert found["pressed"][0] == pytest.approx(pressed, rel=0.05)
    assert abs(CELL**2 * mine.sum() + found["waiting"][0]) < 1e-3 * found["pressed"][0]


def test_who_steps_into_his_print_falls_until_there_is_sand(warp):
    """World 0 has a print already, world 1 has none."""
    worlds = Worlds(warp)
    worlds.put(1, qpos=worlds.raised(1.0), qvel=0.0)
    worlds.step(100, both=True)
    assert worlds.sand.volumes()["pressed"][1] == 0.0
    start = mujoco.MjData(worlds.model)
    start.qvel[[2, 8]] = -0.2
    for world in range(2):
        worlds.put(world, qpos=start.qpos, qvel=start.qvel)
    worlds.data.qpos[:], worlds.data.qvel[:] = start.qpos, start.qvel
    worlds.step(100, both=True)
    depths = 0.03 - worlds.d.qpos.numpy()[:, 2]
    assert depths[0] > depths[1] + 2e-3
    assert depths[0] == pytest.approx(0.03 - worlds.data.qpos[2], abs=1.5e-3)


def test_walls_of_a_crater_rest_at_the_angle_of_repose(warp):
    worlds = Worlds(warp, count=1, box=(0, 0, -1.5))
    worlds.step(100)
    steep = np.abs(np.diff(worlds.heights(), axis=0)).max() / CELL
    for _ in range(4):  # a fall of 0.2 s each
        worlds.put(0, qpos=worlds.raised(0.5), qvel=0.0)
        worlds.step(100)
    heights = worlds.heights()
    assert steep > 1.0
    along, across = np.diff(heights, axis=0), np.diff(heights, axis=1)
    repose = math.tan(MEMORY.repose)
    for a in (along[:, :-1], along[:, 1:]):
        for b in (across[:-1], across[1:]):
            assert 0.7 * repose < np.hypot(a, b).max() / CELL < 1.03 * repose
    assert abs(CELL**2 * heights.sum()) < 1e-3 * worlds.check_books()["pressed"][0]


def test_the_grid_is_wrapped_around_and_what_lay_there_is_forgotten(warp):
    worlds = Worlds(warp, count=1)
    side = MEMORY.size * CELL
    worlds.step(100)
    print_ = worlds.heights()
    assert worlds.sand.volumes()["forgotten"][0] == 0.0
    # The same place of the grid, a tile farther and three tiles back.
    start = mujoco.MjData(worlds.model).qpos
    start[[0, 7]] += side
    start[[1, 8]] -= 3 * side
    worlds.put(0, qpos=start, qvel=worlds.data.qvel)
    worlds.step(100)
    there = worlds.heights(middle=(side, -3 * side))
    # Sand does not flow over the first print, but bodies press and heap there.
    np.testing.assert_allclose(there, print_, atol=3e-3)
    here = worlds.heights()
    assert np.count_nonzero(here) < 0.2 * np.count_nonzero(print_)
    found = worlds.check_books()
    total = CELL**2 * (here.sum() + there.sum()) + found["waiting"][0] + found["forgotten"][0]
    assert abs(total) < 1e-3 * found["pressed"][0]


def test_a_world_that_begins_anew_has_untouched_sand(warp):
    worlds = Worlds(warp)
    worlds.step(100)
    before = worlds.heights(0)
    # Forces are those of untouched sand at once, which a first observation reads.
    fresh, pose = Worlds(warp, count=1), worlds.d.qpos.numpy()[1]
    pose[[0, 7]] += 0.05  # half beside their prints
    for each, world in ((worlds, 1), (fresh, 0)):
        each.put(world, qpos=pose, qvel=worlds.data.qvel, time=0.0)
        mjw.forward(each.m, each.d)
    for name in ("force", "depth"):
        found, right = (getattr(each.sand, name).numpy() for each in (worlds, fresh))
        np.testing.assert_allclose(found[1], right[0], rtol=1e-3, atol=1e-4)
    worlds.step(1)
    worlds.put(1, qpos=mujoco.MjData(worlds.model).qpos, qvel=worlds.data.qvel, time=0.0)
    worlds.step(1)
    assert not worlds.heights(1).any()
    assert worlds.sand.volumes()["pressed"][1] == 0.0
    worlds.step(99)
    np.testing.assert_allclose(worlds.heights(1), before, atol=1e-6)
    np.testing.assert_allclose(worlds.d.qpos.numpy()[1], worlds.d.qpos.numpy()[0], atol=1e-3)


def test_a_first_episode_in_the_sand_is_like_the_next(warp):
    worlds, found = Worlds(warp, count=1), []
    for _ in range(2):
        start = {"qpos": worlds.raised(-0.03), "qvel": worlds.data.qvel}
        worlds.put(0, **start, qacc_warmstart=0.0, time=0.0)
        worlds.step(20)
        found.append((worlds.heights(), worlds.d.qpos.numpy()))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_array_equal(found[0][1], found[1][1])


def test_forward_changes_nothing(warp):
    disturbed, alone = Worlds(warp, count=1), Worlds(warp, count=1)
    for _ in range(40):
        alone.step(1)
        for _ in range(5):
            mjw.forward(disturbed.m, disturbed.d)
        disturbed.step(1)
    np.testing.assert_allclose(disturbed.heights(), alone.heights(), atol=1e-4)
    books, right = disturbed.sand.volumes(), alone.sand.volumes()
    np.testing.assert_allclose(books["pressed"], right["pressed"], rtol=1e-3)


def test_without_gravity_prints_are_pressed(warp):
    worlds = Worlds(warp, count=1)
    worlds.m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    worlds.on_processor.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    worlds.put(0, qpos=worlds.raised(-0.03))
    worlds.data.qpos[:] = worlds.raised(-0.03)
    worlds.step(40, both=True)
    right = worlds.on_processor.relief(worlds.data, (0.0, 0.0)).height
    assert right.min() < -0.01
    found = worlds.heights()
    assert found.min() == pytest.approx(right.min(), abs=1e-3)
    assert (abs(found - right) > 2e-3).sum() < 0.1 * (right < -2e-3).sum()


def test_what_cannot_be_is_told(warp):
    worlds = Worlds(warp, count=2)
    with pytest.raises(InputError, match=r"there are 2 worlds, 0 to 1, not 2"):
        worlds.heights(2)
    with pytest.raises(InputError, match="the middle is two numbers"):
        worlds.heights(0, 3.0)
    dry = warp.WarpSand(worlds.model)
    with pytest.raises(InputError, match="attach the sand first"):
        dry.volumes()
    with pytest.raises(InputError, match="too small for surroundings"):
        Worlds(warp, memory=Memory(cell=CELL, extent=0.3))
