"""What is drawn of sand that remembers is where the sand is, and drawing it changes nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import process_time

import mujoco
import numpy as np
import pytest

from mjgranular import Bed, HeightField, Memory, Plane, Sand, SandSpec, Surface, add_sand
from mjgranular.engine import relief_of, show_prints
from mjgranular.engine.looks import DrawnSand
from mjgranular.render import Replay, TrackRecorder, Tracks

CELL = 0.02
MEMORY = Memory(cell=CELL, extent=1.2)
SAND = {"law": "rft3d", "scheme": "explicit", "memory": MEMORY}
BALL = '<body pos="0.03 0.05 0.06"><freejoint/><geom name="b" size="0.06" mass="4"/></body>'
RISE = 0.2  # of the ramp, a height field of 2 m


@dataclass(frozen=True)
class Ground:
    """A surface, the geom that it is, and the plane that heights are over, known without it."""

    surface: Surface
    geom: str
    origin: np.ndarray
    along: np.ndarray
    normal: np.ndarray

    def place(self, points: np.ndarray) -> np.ndarray:
        """Places along the axes of the plane, shape (n, 3)."""
        axes = np.array([self.along, np.cross(self.normal, self.along), self.normal])
        return (points - self.origin) @ axes.T

    def level(self, u: np.ndarray) -> np.ndarray:
        """Height of the surface over its plane."""
        is_ramp = isinstance(self.surface, HeightField)
        return RISE * (u / 2 + 0.5) if is_ramp else np.zeros_like(u)


X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
TILT = math.radians(15)
GROUNDS = {
    "plane": Ground(Plane(height=0.01), "", 0.01 * Z, X, Z),
    "slope": Ground(
        Plane(slope=TILT),
        "",
        np.zeros(3),
        np.array([math.cos(TILT), 0.0, math.sin(TILT)]),
        np.array([-math.sin(TILT), 0.0, math.cos(TILT)]),
    ),
    "bed": Ground(
        Bed("bed"),
        '<geom name="bed" type="box" pos="0.1 0 -0.1" size="0.3 0.25 0.1"/>',
        np.array([0.1, 0.0, 0.0]),
        X,
        Z,
    ),
    "field": Ground(
        HeightField("field"),
        '<geom name="field" type="hfield" hfield="ramp" pos="0 0 -0.05"/>',
        np.array([0.0, 0.0, -0.05]),
        X,
        Z,
    ),
}


def spec_of(ground: Ground) -> mujoco.MjSpec:
    ramp = '<asset><hfield name="ramp" nrow="3" ncol="21" size="1 1 0.2 0.1"/></asset>'
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="5e-4"/>{ramp}<worldbody>{ground.geom}{BALL}'
        "</worldbody></mujoco>"
    )
    spec.hfield("ramp").userdata = np.tile(np.linspace(0, 1, 21), 3)
    return spec


def scene_of(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjvScene:
    scene = mujoco.MjvScene(model, 1000)
    option, grasp, camera = mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.MjvCamera()
    mujoco.mjv_updateScene(model, data, option, grasp, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    return scene


def check(ground: Ground, scene: mujoco.MjvScene, heights: np.ndarray, x: np.ndarray) -> None:
    """Holds the vertices and rectangles of a scene against heights at nodes x, x."""
    lines = MEMORY.size + 20
    vertices = ground.place(np.array(scene.skinvert, float).reshape(-1, 3))
    i, j = np.nonzero(heights)
    assert len(i) > 20
    nodes = np.rint(x / CELL).astype(int)
    at = (nodes[i] % lines) * lines + nodes[j] % lines
    u, v = x[i], x[j]
    np.testing.assert_allclose(vertices[at, 0], u, atol=1e-6)
    np.testing.assert_allclose(vertices[at, 1], v, atol=1e-6)
    np.testing.assert_allclose(vertices[at, 2], ground.level(u) + heights[i, j], atol=1e-6)
    kinds = [geom.type for geom in scene.geoms[: scene.ngeom]]
    assert kinds.count(int(mujoco.mjtGeom.mjGEOM_SKIN)) == 1
    for geom in scene.geoms[: scene.ngeom]:
        if geom.type != mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        middle = ground.place(np.array(geom.pos, float))
        assert abs(middle[2]) < 1e-6
        np.testing.assert_allclose(
            np.array(geom.mat, float).reshape(3, 3)[:, 2], ground.normal, atol=1e-6
        )
        half = np.array(geom.size[:2], float)
        beside = (np.abs(u - middle[0]) > half[0] - 1e-6) | (np.abs(v - middle[1]) > half[1] - 1e-6)
        assert beside.all()  # nothing plane lies over a print


def square(x: np.ndarray, y: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights on nodes that are the same along both axes."""
    ends = min(x[0], y[0]), max(x[-1], y[-1])
    nodes = np.arange(round(ends[0] / CELL), round(ends[1] / CELL) + 1)
    found = np.zeros((len(nodes), len(nodes)))
    i, j = (np.rint(z / CELL).astype(int) - nodes[0] for z in (x, y))
    found[np.ix_(i, j)] = height
    return found, CELL * nodes


@pytest.fixture(scope="module", params=GROUNDS)
def fallen(request: pytest.FixtureRequest) -> tuple:
    """A ball that has fallen into sand inside mj_step."""
    ground = GROUNDS[request.param]
    spec = spec_of(ground)
    add_sand(spec, surface=ground.surface, **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(300):
        mujoco.mj_step(model, data)
    return ground, model, data


def test_the_plugin_draws_prints_where_they_are(fallen: tuple) -> None:
    ground, model, data = fallen
    relief = relief_of(model, data)
    check(ground, scene_of(model, data), *square(relief.x, relief.y, relief.height))


def test_what_joins_the_ends_of_a_window_is_under_the_field(fallen: tuple) -> None:
    ground, model, data = fallen
    if not isinstance(ground.surface, HeightField):
        return
    scene = scene_of(model, data)
    fields = (g for g in scene.geoms[: scene.ngeom] if g.type == mujoco.mjtGeom.mjGEOM_HFIELD)
    sunk = min(float(geom.pos[2]) for geom in fields) - ground.origin[2]
    vertices = np.array(scene.skinvert, float).reshape(-1, 3)[: (MEMORY.size + 20) ** 2]
    u, v, z = ground.place(vertices).T
    beyond = np.maximum(abs(u), abs(v)) > CELL * (MEMORY.size / 2 + 1)
    assert beyond.any()
    assert (z[beyond] < ground.level(u[beyond]) + sunk).all()


def test_what_is_plane_is_covered_once(fallen: tuple) -> None:
    ground, model, data = fallen
    if isinstance(ground.surface, HeightField):
        pytest.skip("its surface is not plane")
    scene, relief = scene_of(model, data), relief_of(model, data)
    rectangles = [
        (ground.place(np.array(g.pos, float)), np.array(g.size, float))
        for g in scene.geoms[: scene.ngeom]
        if g.type == mujoco.mjtGeom.mjGEOM_PLANE
    ]
    i, j = np.nonzero(relief.height)
    random = np.random.default_rng(0)
    for u, v in random.uniform(-0.19, 0.19, (200, 2)):
        count = sum(
            abs(u - middle[0]) < half[0] and abs(v - middle[1]) < half[1]
            for middle, half in rectangles
        )
        near = np.maximum(np.abs(relief.x[i] - u), np.abs(relief.y[j] - v)).min() < 11 * CELL
        assert count == 1 or (count == 0 and near)


def test_drawing_changes_no_bit_of_the_physics() -> None:
    ends = []
    for draw in ("surface", ()):
        spec = spec_of(GROUNDS["plane"])
        add_sand(spec, draw=draw, **SAND)
        model = spec.compile()
        data = mujoco.MjData(model)
        for step in range(200):
            mujoco.mj_step(model, data)
            if draw and step % 50 == 0:
                scene_of(model, data)
        ends.append(np.concatenate([data.qpos, data.qvel, data.plugin_state]))
    np.testing.assert_array_equal(*ends)


def test_a_skin_is_all_that_comes_with_it() -> None:
    spec = spec_of(GROUNDS["plane"])
    bare = spec.compile()
    add_sand(spec, **SAND)
    model = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert model.nskin == 1
    for name in ("nq", "nv", "nbody", "ngeom", "nsensordata", "nlight", "nhfielddata"):
        assert getattr(model, name) == getattr(bare, name), name
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    kinds = [geom.type for geom in scene_of(model, data).geoms]
    assert int(mujoco.mjtGeom.mjGEOM_SKIN) in kinds


def test_a_film_has_prints_where_the_run_had_them() -> None:
    ground = GROUNDS["plane"]
    spec = spec_of(ground)
    sand_spec = SandSpec(surface=ground.surface, **SAND)
    show_prints(spec, sand_spec)
    model = spec.compile()
    data, sand = mujoco.MjData(model), Sand(model, sand_spec)
    recorder, seen = TrackRecorder(sand, data, 0.15), {}
    for step in range(301):
        if step % 100 == 0:
            recorder.look(data.time, last=True)
            seen[data.time] = sand.relief(data)
        sand.step(data)
    prints = Tracks.from_arrays(recorder.prints().arrays())
    cover, replay = DrawnSand(model, ground.surface, MEMORY, unit=0.5), Replay(prints, MEMORY)
    assert all(relief.height.any() for time, relief in seen.items() if time > 0.06)
    for time, relief in reversed(seen.items()):
        cover.lay(replay.to(time), np.zeros(3))
        scene = scene_of(model, data)
        cover.show(scene)
        heights, x = square(relief.x, relief.y, relief.height)
        lines = MEMORY.size + 20
        nodes = np.rint(x / CELL).astype(int)
        i, j = np.nonzero(heights)
        at = (nodes[i] % lines) * lines + nodes[j] % lines
        drawn = np.array(scene.skinvert).reshape(-1, 3)[at, 2] - 0.01
        np.testing.assert_allclose(drawn, heights[i, j], atol=1.1e-3 * CELL)


@pytest.mark.parametrize(
    ("look", "color"),
    [
        ('material="brown"', [0.3, 0.1, 0.2]),
        ('material="green" rgba="0.2 0.5 0.2 1"', [0.2, 0.5, 0.2]),
        ('rgba="0.1 0.2 0.3 1"', [0.1, 0.2, 0.3]),
        ('name="bed"', [1.0, 1.0, 1.0]),  # the texture of sand
    ],
)
def test_a_bed_with_prints_has_the_color_of_its_geom(look: str, color: list[float]) -> None:
    name = look.split('"')[1]
    spec = mujoco.MjSpec.from_string(f"""<mujoco>
      <asset><material name="{name}" rgba="0.3 0.1 0.2 1"/></asset>
      <worldbody>
      <geom name="bed" type="box" size="1 1 1" pos="0 0 -1" {look.replace('name="bed"', "")}/>
      {BALL}</worldbody></mujoco>""")
    add_sand(spec, surface=Bed("bed"), **SAND)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    drawn = [geom.rgba for geom in scene_of(model, data).geoms if geom.matid == model.skin_matid]
    np.testing.assert_allclose(model.skin_rgba[0, :3], color)
    np.testing.assert_allclose(drawn[0], [*color, 1.0])


def test_a_skin_of_another_memory_is_an_error() -> None:
    spec = spec_of(GROUNDS["plane"])
    show_prints(spec, SandSpec(memory=0.02))
    add_sand(spec, **(SAND | {"memory": Memory(cell=0.02, extent=6.0)}))
    with pytest.raises(ValueError, match="skin mjgranular_prints is of another memory: delete it"):
        mujoco.MjData(spec.compile())


def test_recording_prints_in_fine_cells_is_fast() -> None:
    ground = GROUNDS["plane"]
    model = spec_of(ground).compile()
    sand = Sand(model, surface=ground.surface, **(SAND | {"memory": Memory(cell=0.001)}))
    data = mujoco.MjData(model)
    recorder = TrackRecorder(sand, data, 1.0)
    sand.step(data)
    begin = process_time()
    for instant in range(3):
        recorder.look(float(instant), last=True)
    assert process_time() - begin < 0.6  # 4 million nodes, of which some thousand changed


@pytest.mark.parametrize(
    "damage",
    [
        {"prints_t": np.array([0.0, 0.0])},
        {"prints_end": np.array([2, 1])},
        {"prints_end": np.array([0, 7])},
        {"prints_node": np.full((1, 2), 1 << 22)},
        {"prints_node": np.zeros((1, 3), int)},
        {"prints_height": np.array([np.nan])},
    ],
)
def test_damaged_prints_are_refused(damage: dict[str, np.ndarray]) -> None:
    whole = {
        "prints_t": np.array([0.0, 1.0]),
        "prints_end": np.array([0, 1]),
        "prints_node": np.array([[3, -4]]),
        "prints_height": np.array([-0.01]),
    }
    replay = Replay(Tracks.from_arrays(whole), MEMORY)
    assert replay.to(0.0).min() == 0.0
    assert replay.to(0.5).min() == pytest.approx(-0.005)
    assert replay.to(1.0).min() == pytest.approx(-0.01)
    assert replay.to(0.0).min() == 0.0  # and back
    with pytest.raises(ValueError, match="prints"):
        Tracks.from_arrays(whole | damage)


@pytest.mark.parametrize("cell", [0.01, 0.005, 0.0025])
def test_what_is_remembered_is_drawn_to_a_meter_away_at_any_cell_size(cell: float) -> None:
    ground, memory, far = GROUNDS["plane"], Memory(cell=cell), 0.9
    nodes = round(far / cell) + np.arange(8)
    both = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), axis=-1).reshape(-1, 2)
    replay = Replay(
        Tracks(np.zeros(1), np.array([64]), both.astype(np.int32), np.full(64, -0.02)), memory
    )
    spec = spec_of(ground)
    show_prints(spec, SandSpec(surface=ground.surface, **(SAND | {"memory": memory})))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    cover = DrawnSand(model, ground.surface, memory, unit=0.5)
    cover.lay(replay.to(0.0), np.zeros(3))
    scene = scene_of(model, data)
    vertices = np.array(scene.skinvert).reshape(-1, 3)
    deep = vertices[np.abs(vertices[:, 2] - 0.01 + 0.02) < 1e-6]
    assert len(deep) >= 16
    assert np.abs(deep[:, :2] - far - 3.5 * cell).max() < 4 * cell
    assert len(vertices) < 200_000
