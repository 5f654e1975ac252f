"""Where the sand is: planes, beds and height fields against geometry done otherwise."""

import dataclasses
import math
from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.interpolate import RegularGridInterpolator

from mjgranular import (
    Bed,
    DepthVelocityLaw,
    DistributedLinkLaw,
    HeightField,
    InputError,
    LinkLaw,
    Plane,
    Rft2dLaw,
    Rft3dLaw,
    Sand,
    Surface,
    UnknownNameError,
    UnstableError,
    media,
)
from mjgranular.kernel import compiled
from mjgranular.kernel.vector import read_vector, vector

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

LAWS = {
    "link": LinkLaw.from_medium(media["play_sand"]),
    "link_distributed": DistributedLinkLaw.from_medium(media["play_sand"]),
    "rft2d": Rft2dLaw.generic(1.0),
    "rft3d": Rft3dLaw.from_medium(media["quikrete_medium"]),
    "depth_velocity": DepthVelocityLaw(1.0, 200.0, 1.3, 0.5, 2.0),
}
# One law of each kind of element: rods, facets, whole bodies.
each_law = pytest.mark.parametrize("law", ["link_distributed", "rft3d", "depth_velocity"])

# Every law has elements for a capsule.
PILL = "<geom name='pill' type='capsule' fromto='-0.02 0.01 -0.03 0.03 0 0.04' size='0.012'/>"
BALL = "<geom name='ball' type='sphere' size='0.05'/>"


def scene(world, geom=PILL, extra=""):
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          {extra}
          <worldbody>
            {world}
            <body name="body">
              <freejoint/>
              <inertial pos="0.01 0 0.02" mass="0.3" diaginertia="1e-3 2e-3 2e-3"/>
              {geom}
            </body>
          </worldbody>
        </mujoco>""")


def matrix(quaternion):
    quaternion = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def about(axis, angle):
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])


def times(q, p):
    out = np.zeros(4)
    mujoco.mju_mulQuat(out, np.asarray(q, float), np.asarray(p, float))
    return out


def text(numbers):
    # Rounded: MuJoCo 3.17 reads no 1e-46.
    return " ".join(str(round(float(number), 15)) for number in numbers)


def wrench(sand, position, quaternion=(1, 0, 0, 0), velocity=(0, 0, 0), spin=(0, 0, 0)):
    """Force and moment of the sand on the free body, shape (6,)."""
    data = mujoco.MjData(sand.model)
    quaternion = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    data.qpos[:3], data.qpos[3:7] = position, quaternion
    data.qvel[:3], data.qvel[3:6] = velocity, matrix(quaternion).T @ np.asarray(spin, float)
    (report,) = sand.report(data).bodies
    return np.concatenate([report.force, report.moment])


def probe(surface, model, point):
    """Depth and normal."""
    call = called(type(surface).probe)
    depth, *normal = call(surface.record(model)[0], np.array(point, float))
    return depth, np.array(normal)


@cache
def called(probe):
    """A probe of vectors as a function of an array."""

    @njit(error_model="numpy")
    def call(record, point):
        depth, normal = probe(record, read_vector(point, 0))
        return depth, normal.x, normal.y, normal.z

    return call


def number(low, high):
    # MuJoCo 3 cannot read a subnormal number, which half of a very small one is.
    return st.floats(low, high).map(lambda x: x if abs(x) > 1e-300 else 0.0)


POINTS = st.tuples(*[number(-2, 2)] * 3).map(np.array)


# Planes


@given(height=number(-1, 1), slope=number(-1.4, 1.4), uphill=number(-4, 4), point=POINTS)
def test_depth_below_a_plane_is_along_its_normal(height, slope, uphill, point):
    plane = Plane(height, slope, uphill)
    depth, normal = probe(plane, None, point)
    assert normal == pytest.approx(plane.normal, abs=1e-15)
    # Walked up along the normal, the point is on z = height + tan(slope) (distance uphill).
    x, y, z = point + depth * normal
    rise = math.tan(slope) * (x * math.cos(uphill) + y * math.sin(uphill))
    assert z == pytest.approx(height + rise, abs=1e-11)
    assert plane.tilt(scene("")) == pytest.approx(abs(slope), abs=1e-15)


@pytest.mark.parametrize("slope", [0.0, 0.3])
@each_law
def test_gravity_does_not_turn_with_a_plane(law, slope):
    # Slope and gravity are independent: of gravity the laws take the size alone.
    model = scene("")
    sand = Sand(model, law=LAWS[law], surface=Plane(slope=slope), scheme="explicit")
    state = ([0, 0, -0.03], [0.8, 0.3, -0.2, 0.1], [0.3, -0.2, -0.5], [1, 2, -3])
    expected = wrench(sand, *state)
    assert expected.any()
    model.opt.gravity[:] = 9.81 * np.array([0.6, 0, -0.8])
    assert wrench(sand, *state) == pytest.approx(expected, rel=1e-12)


# Beds

BOX = "<geom name='bed' type='box' size='0.5 0.3 0.1' pos='0 0 -0.1'/>"
INSIDE = ([0.1, -0.1, -0.02], [0.9, 0.2, 0.1, -0.3], [0.3, -0.2, -0.5], [1, 2, -3])


@each_law
def test_bed_is_a_plane_where_it_is(law):
    bed = Sand(scene(BOX), law=LAWS[law], surface=Bed("bed"), scheme="explicit")
    plane = Sand(scene(""), law=LAWS[law], scheme="explicit")
    expected = wrench(plane, *INSIDE)
    assert expected.any()
    assert wrench(bed, *INSIDE) == pytest.approx(expected, rel=1e-12)


BESIDE = [(0.58, 0, -0.05), (-0.58, 0, -0.05), (0, 0.38, -0.05), (0.7, -0.7, -0.02)]


@pytest.mark.parametrize("place", BESIDE)
@each_law
def test_no_sand_beside_a_bed(law, place):
    sand = Sand(scene(BOX), law=LAWS[law], surface=Bed("bed"), scheme="explicit")
    assert not wrench(sand, place, velocity=(0.1, 0.2, -1)).any()


@pytest.mark.parametrize("place", [(0.54, 0, -0.02), (0.54, 0, 3), (0, 0.34, -3), (0, -0.32, 0.2)])
@pytest.mark.parametrize("law", ["link", "link_distributed", "rft3d", "depth_velocity"])
def test_no_sand_near_the_edge_of_a_bed(law, place):
    # Nearer to the edge than the body is long, with nothing of its axis above or in the bed.
    sand = Sand(
        scene(BOX, "<geom type='capsule' fromto='0 0 -0.05 0 0 0.05' size='0.012'/>"),
        law=LAWS[law],
        surface=Bed("bed"),
        scheme="explicit",
    )
    assert not wrench(sand, place, velocity=(0.1, 0.2, -1)).any()


@each_law
def test_no_sand_under_a_bed(law):
    sand = Sand(scene(BOX), law=LAWS[law], surface=Bed("bed"), scheme="explicit")
    assert not wrench(sand, (0, 0, -0.5), velocity=(0.1, 0.2, -1)).any()


def test_only_what_is_in_the_bed_counts():
    # A ball half over the edge: half the force of one that is all in, by symmetry.
    sand = Sand(
        scene(BOX, BALL), law=LAWS["rft3d"], surface=Bed("bed"), resolution=32, scheme="explicit"
    )
    whole = wrench(sand, (0.2, 0, -0.1), velocity=(0, 0, -1))
    half = wrench(sand, (0.5, 0, -0.1), velocity=(0, 0, -1))
    assert half[2] == pytest.approx(whole[2] / 2, rel=1e-9)


@each_law
@settings(max_examples=40)
@given(
    turn=number(-3, 3),
    slope=number(-1.2, 1.2),
    heading=number(-3, 3),
    offset=st.tuples(number(-1, 1), number(-1, 1), number(-1, 1)).map(np.array),
)
def test_bed_may_be_tilted_turned_and_moved(law, turn, slope, heading, offset):
    # The whole scene is: bed, body, motion and gravity. The bed is on a body of the world.
    q = times(about([math.cos(heading), math.sin(heading), 0], slope), about([0, 0, 1], turn))
    R = matrix(q)
    world = f"""
        <body pos='{text(offset)}' quat='{text(q)}'>
          <geom name='bed' type='box' size='0.5 0.3 0.1' pos='0.2 0.1 -0.1'/>
        </body>"""
    model = scene(world)
    model.opt.gravity[:] = R @ [0, 0, -9.81]
    position, quaternion, velocity, spin = (np.array(part) for part in INSIDE)
    expected = wrench(Sand(scene(""), law=LAWS[law], scheme="explicit"), *INSIDE)
    sand = Sand(model, law=LAWS[law], surface=Bed("bed"), scheme="explicit")
    found = wrench(sand, R @ position + offset, times(q, quaternion), R @ velocity, R @ spin)
    expected = np.concatenate([R @ expected[:3], R @ expected[3:]])
    assert found == pytest.approx(expected, abs=1e-8 * np.linalg.norm(expected))
    assert sand.surface.tilt(model) == pytest.approx(0.0, abs=1e-7)
    model.opt.gravity[:] = 0.0, 0.0, -9.81
    assert sand.surface.tilt(model) == pytest.approx(abs(slope), abs=1e-7)


def test_bed_equals_a_sloping_plane():
    slope, uphill = 0.3, 0.7
    q = about([math.sin(uphill), -math.cos(uphill), 0], slope)
    place = f"quat='{text(q)}' pos='{text(-matrix(q)[:, 2])}'"
    model = scene(f"<geom name='bed' type='box' size='3 3 1' {place}/>")
    for point in np.random.default_rng(0).uniform(-1, 1, (50, 3)):
        depth, normal = probe(Bed("bed"), model, point)
        expected, up = probe(Plane(0.0, slope, uphill), None, point)
        assert depth == pytest.approx(expected, abs=1e-12)
        assert normal == pytest.approx(up, abs=1e-12)


def test_depth_beside_a_bed_is_negative():
    depth, _ = probe(Bed("bed"), scene(BOX), (0.75, 0, -0.05))
    assert depth == pytest.approx(-0.25)


def settle(surface, extra="", steps=400, **options):
    floor = "<geom name='floor' type='plane' size='2 2 1' pos='0 0 -0.2'/>"
    model = scene(BOX + floor, BALL, extra)
    model.opt.timestep = 1e-3
    sand = Sand(model, surface=surface, **{"law": "link", **options}, scheme="explicit")
    data = mujoco.MjData(model)
    data.qpos[2] = 0.1
    touched = set()
    for _ in range(steps):
        sand.step(data)
        touched |= {frozenset(model.geom(int(i)).name for i in pair) for pair in data.contact.geom}
    return data, touched


def test_bed_is_no_obstacle_but_its_floor_is():
    data, touched = settle(Bed("bed"), law=DepthVelocityLaw(linear=1.0))
    assert touched == {frozenset({"ball", "floor"})}
    assert data.qpos[2] == pytest.approx(-0.15, abs=2e-3)


@pytest.mark.parametrize("ends", ["geom1='bed' geom2='ball'", "geom1='ball' geom2='bed'"])
@pytest.mark.parametrize("name", ["", "stop"])
def test_bed_in_an_explicit_pair_is_refused(ends, name):
    attribute = f"name='{name}'" if name else ""
    pairs = f"<pair geom1='ball' geom2='floor'/><pair {attribute} {ends}/>"
    floor = "<geom name='floor' type='plane' size='2 2 1' pos='0 0 -0.2'/>"
    model = scene(BOX + floor, BALL, f"<contact>{pairs}</contact>")
    named = repr(name) if name else r"\d"
    message = rf"contact pair {named} makes geoms .*'ball'.* collide, but 'bed' is a bed.*remove"
    with pytest.raises(InputError, match=message):
        Sand(model, surface=Bed("bed"), law=DepthVelocityLaw(linear=1.0), scheme="explicit")
    assert model.geom("bed").contype[0] == 1  # nothing was changed
    Sand(model, law=DepthVelocityLaw(linear=1.0), scheme="explicit")  # other geoms may have pairs


def test_a_bed_left_alone_is_an_obstacle():
    data, touched = settle(Plane(-5.0), law=DepthVelocityLaw(linear=1.0))
    assert touched == {frozenset({"ball", "bed"})}
    assert data.qpos[2] == pytest.approx(0.05, abs=2e-3)


def test_sand_stays_visible():
    model = scene(BOX)
    before = model.geom_rgba.copy(), model.geom_group.copy()
    Sand(model, law="link", surface=Bed("bed"), scheme="explicit")
    assert (model.geom_rgba == before[0]).all()
    assert (model.geom_group == before[1]).all()


HFIELD = "<asset><hfield name='dunes' nrow='{}' ncol='{}' size='{} {} {} 0.1'/></asset>"


@pytest.mark.parametrize(
    ("surface", "kind"), [(Bed, "box"), (HeightField, "hfield")], ids=["bed", "height field"]
)
class TestNames:
    world = BOX + "<geom name='dunes' type='hfield' hfield='dunes' pos='5 0 0'/>"
    world += "<geom name='floor' type='plane' size='1 1 1' pos='0 0 -1'/>"
    extra = HFIELD.format(3, 3, 1, 1, 1)

    def test_unknown(self, surface, kind):
        with pytest.raises(UnknownNameError) as caught:
            Sand(
                scene(self.world, extra=self.extra),
                law="link",
                surface=surface("sandbde"),
                scheme="explicit",
            )
        assert caught.value.known == ({"box": "bed", "hfield": "dunes"}[kind],)
        assert f"no {kind} geom of the model 'sandbde'" in str(caught.value)

    def test_none_at_all(self, surface, kind):
        with pytest.raises(UnknownNameError, match="there are: none"):
            Sand(scene(""), law="link", surface=surface("bed"), scheme="explicit")

    def test_other_geom(self, surface, kind):
        message = f"'floor' is a plane: a .* is made of a {kind} geom"
        with pytest.raises(InputError, match=message):
            Sand(
                scene(self.world, extra=self.extra),
                law="link",
                surface=surface("floor"),
                scheme="explicit",
            )

    @pytest.mark.parametrize("how", ["<joint/>", "mocap='true'"])
    def test_on_a_body_that_moves(self, surface, kind, how):
        shape = {
            "box": "type='box' size='1 1 1'",
            "hfield": "type='hfield' hfield='dunes' mass='1'",
        }[kind]
        attribute, joint = (how, "") if "=" in how else ("", how)
        cart = f"""<body name='cart' {attribute}>{joint}
                     <inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>
                     <geom name='load' {shape}/></body>"""
        with pytest.raises(InputError, match=r"'load' is on body 'cart', which can move"):
            Sand(
                scene(cart, extra=self.extra),
                surface=surface("load"),
                bodies="body",
                scheme="explicit",
            )


# Height fields


def dunes(heights, half=(1.0, 0.6), elevation=0.2, place=""):
    """A model with an hfield geom; heights [m], rows over y, columns over x."""
    rows, columns = np.shape(heights)
    model = scene(
        f"<geom name='dunes' type='hfield' hfield='dunes' {place}/>",
        extra=HFIELD.format(rows, columns, *half, elevation),
    )
    model.hfield_data[:] = np.ravel(heights) / elevation
    return model


def drawn_heights(rows=5, columns=7, seed=0):
    return np.random.default_rng(seed).uniform(0, 0.2, (rows, columns)).astype(np.float32)


FIELD = HeightField("dunes")


def test_height_is_bilinear():
    heights = drawn_heights()
    model = dunes(heights)
    expected = RegularGridInterpolator(
        (np.linspace(-0.6, 0.6, 5), np.linspace(-1, 1, 7)), heights.astype(float)
    )
    rng = np.random.default_rng(1)
    for x, y in rng.uniform((-1, -0.6), (1, 0.6), (300, 2)):
        (height,) = expected([[y, x]])
        depth, normal = probe(FIELD, model, (x, y, height))
        assert depth == pytest.approx(0, abs=1e-7)  # heights are in single precision
        for z in (-0.3, 0.5):
            # Along the normal of the surface above or below the point.
            depth, normal = probe(FIELD, model, (x, y, z))
            assert depth == pytest.approx((height - z) * normal[2], abs=1e-7)


def test_normal_is_that_of_the_surface():
    heights = drawn_heights(seed=2)
    model = dunes(heights)
    surface = RegularGridInterpolator(
        (np.linspace(-0.6, 0.6, 5), np.linspace(-1, 1, 7)), heights.astype(float)
    )
    step = 1e-5
    rng = np.random.default_rng(3)
    checked = 0
    for x, y in rng.uniform((-0.99, -0.59), (0.99, 0.59), (300, 2)):
        cell = np.array([(x + 1) * 3, (y + 0.6) / 0.3])
        if np.abs(cell - np.round(cell)).min() < 1e-3:
            continue  # a kink between cells
        (east,), (west,) = surface([[y, x + step]]), surface([[y, x - step]])
        (north,), (south,) = surface([[y + step, x]]), surface([[y - step, x]])
        expected = np.array([-(east - west) / (2 * step), -(north - south) / (2 * step), 1])
        expected /= np.linalg.norm(expected)
        _, normal = probe(FIELD, model, (x, y, 0.1))
        assert normal == pytest.approx(expected, abs=1e-6)
        checked += 1
    assert checked > 250


def test_heights_lie_where_mujoco_draws_them():
    heights = drawn_heights(seed=4)
    model = dunes(heights, place="pos='0.3 -0.2 0.1' euler='20 -10 70'")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = model.geom("dunes").id
    R, origin = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    for x, y in np.random.default_rng(5).uniform((-0.99, -0.59), (0.99, 0.59), (100, 2)):
        start = origin + R @ [x, y, 1.0]
        away = mujoco.mj_rayHfield(model, data, geom, start, -R[:, 2], None)
        depth, _ = probe(FIELD, model, start - away * R[:, 2])
        # MuJoCo cuts each cell into two triangles: the same at corners, near elsewhere.
        assert abs(depth) < 0.05
    for i, y in enumerate(np.linspace(-0.6, 0.6, 5)):
        for j, x in enumerate(np.linspace(-1, 1, 7)):
            start = origin + R @ [0.9999 * x, 0.9999 * y, 1.0]
            away = mujoco.mj_rayHfield(model, data, geom, start, -R[:, 2], None)
            assert 1.0 - away == pytest.approx(heights[i, j], abs=1e-3)
            depth, _ = probe(FIELD, model, start - away * R[:, 2])
            assert depth == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("shape", [(2, 2), (3, 11)])
@each_law
def test_tilted_plane_in_a_height_field_is_the_plane(law, shape):
    slope, uphill = 0.25, 0.8
    rows, columns = shape
    x, y = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-0.6, 0.6, rows))
    lift = 0.5
    heights = lift + math.tan(slope) * (x * math.cos(uphill) + y * math.sin(uphill))
    model = dunes(heights, elevation=1.0, place=f"pos='0 0 {-lift}'")
    field = Sand(model, law=LAWS[law], surface=FIELD, scheme="explicit")
    plane = Sand(scene(""), law=LAWS[law], surface=Plane(0.0, slope, uphill), scheme="explicit")
    for place in [(0, 0, -0.02), (0.4, -0.3, -0.02), (-0.7, 0.2, -0.2)]:
        state = (place, *INSIDE[1:])
        expected = wrench(plane, *state)
        assert expected.any()
        assert wrench(field, *state) == pytest.approx(
            expected, abs=1e-5 * np.linalg.norm(expected)
        )  # heights are kept in single precision
    assert field.surface.tilt(model) >= slope - 1e-6


@each_law
def test_flat_height_field_is_a_bed(law):
    model = dunes(np.full((4, 5), 0.125), elevation=0.25, place="pos='0 0 -0.125'")
    assert wrench(
        Sand(model, law=LAWS[law], surface=FIELD, scheme="explicit"), *INSIDE
    ) == pytest.approx(wrench(Sand(scene(""), law=LAWS[law], scheme="explicit"), *INSIDE), rel=1e-9)
    assert FIELD.tilt(model) == 0


@pytest.mark.parametrize("place", [(1.2, 0, 0.05), (-1.2, 0, 0.05), (0, 0.8, 0), (0, -0.8, -1)])
@each_law
def test_no_sand_outside_a_height_field(law, place):
    sand = Sand(dunes(drawn_heights()), law=LAWS[law], surface=FIELD, scheme="explicit")
    assert not wrench(sand, place, velocity=(0.1, 0.2, -1)).any()


@each_law
def test_height_field_may_be_turned_and_moved(law):
    heights, offset = drawn_heights(seed=6), np.array([0.4, -0.3, 0.2])
    q = times(about([1, 2, 0], 0.4), about([0, 0, 1], 1.1))
    R = matrix(q)
    level = Sand(dunes(heights), law=LAWS[law], surface=FIELD, scheme="explicit")
    model = dunes(heights, place=f"pos='{text(offset)}' quat='{text(q)}'")
    turned = Sand(model, law=LAWS[law], surface=FIELD, scheme="explicit")
    _, quaternion, velocity, spin = (np.array(part) for part in INSIDE)
    for position in np.random.default_rng(7).uniform((-0.8, -0.4, 0), (0.8, 0.4, 0.1), (10, 3)):
        expected = wrench(level, position, quaternion, velocity, spin)
        found = wrench(turned, R @ position + offset, times(q, quaternion), R @ velocity, R @ spin)
        expected = np.concatenate([R @ expected[:3], R @ expected[3:]])
        assert found == pytest.approx(expected, abs=1e-8 * np.linalg.norm(expected) + 1e-12)


@each_law
def test_heights_may_change_while_it_runs(law):
    model = dunes(np.full((4, 5), 0.0))
    sand = Sand(model, law=LAWS[law], surface=FIELD, scheme="explicit")
    state = ([0, 0, 0.1], *INSIDE[1:])
    assert not wrench(sand, *state).any()
    model.hfield_data[:] = 0.12 / 0.2
    expected = wrench(
        Sand(scene(""), law=LAWS[law], surface=Plane(0.12), scheme="explicit"), *state
    )
    assert expected.any()
    assert wrench(sand, *state) == pytest.approx(expected, rel=1e-5)
    model.hfield_size[0, 2] = 0.4
    with pytest.raises(InputError, match="hfield_size of the model was changed"):
        sand.check()


def test_heights_that_are_no_numbers_are_named():
    model = dunes(np.full((4, 5), np.nan))
    with pytest.raises(UnstableError, match="hfield_data must be finite"):
        Sand(model, law="rft3d", surface=FIELD, scheme="explicit").step(mujoco.MjData(model))


def test_dunes_are_no_obstacle():
    model = dunes(np.full((4, 5), 0.1))
    data = mujoco.MjData(model)
    data.qpos[2] = 0.05
    mujoco.mj_forward(model, data)
    assert data.ncon
    Sand(model, law="link", surface=FIELD, scheme="explicit")
    mujoco.mj_forward(model, data)
    assert not data.ncon


def test_second_of_two_height_fields():
    extra = (
        "<asset><hfield name='a' nrow='3' ncol='4' size='1 1 1 .1'/>"
        "<hfield name='b' nrow='2' ncol='3' size='1 1 1 .1'/></asset>"
    )
    world = "<geom name='a' type='hfield' hfield='a'/><geom name='b' type='hfield' hfield='b'/>"
    model = scene(world, extra=extra)
    model.hfield_data[:12] = 0.9
    model.hfield_data[12:] = 0.3
    assert probe(HeightField("b"), model, (0.2, 0.3, 0))[0] == pytest.approx(0.3)
    assert probe(HeightField("a"), model, (0.2, 0.3, 0))[0] == pytest.approx(0.9)


@pytest.mark.parametrize(("rows", "columns"), [(1, 4), (4, 1)])
def test_a_row_is_no_surface(rows, columns):
    model = dunes(np.zeros((4, 4)))
    model.hfield_nrow[0], model.hfield_ncol[0] = rows, columns
    with pytest.raises(InputError, match=f"has {rows} rows and {columns} columns"):
        Sand(model, law="link", surface=FIELD, scheme="explicit")


def test_tilt_of_a_height_field():
    # One slope everywhere: 0.3 along x, 0.4 along y, atan 0.5 together.
    x, y = np.meshgrid(np.linspace(-1, 1, 6), np.linspace(-0.6, 0.6, 5))
    model = dunes(1 + 0.3 * x + 0.4 * y, elevation=2.0)
    assert FIELD.tilt(model) == pytest.approx(math.atan(0.5), abs=1e-6)
    # In each cell the steepest place is a corner.
    model = dunes(drawn_heights(3, 4, seed=5))
    near = [np.add.outer(np.linspace(-a, a, n)[1:-1], [-1e-9, 1e-9]) for a, n in ((1, 4), (0.6, 3))]
    x, y = ([-a, *inner.ravel(), a] for a, inner in zip((1, 0.6), near, strict=True))
    rises = [probe(FIELD, model, (u, v, 0))[1][2] for u in x for v in y]
    assert FIELD.tilt(model) == pytest.approx(math.acos(min(rises)), abs=1e-6)


# All of them


@each_law
@settings(max_examples=40)
@given(
    slope=number(-1.4, 1.4),
    uphill=number(-4, 4),
    height=number(-1, 1),
    velocity=st.tuples(number(-2, 2), number(-2, 2), number(-2, 2)).map(np.array),
)
def test_turned_scene_gives_the_turned_force(law, slope, uphill, height, velocity):
    q = about([math.sin(uphill), -math.cos(uphill), 0], slope)
    R = matrix(q)
    position, quaternion, _, spin = (np.array(part) for part in INSIDE)
    velocity = velocity + np.array([0.01, 0.02, -0.03])
    model = scene("")
    model.opt.gravity[:] = R @ [0, 0, -9.81]
    sand = Sand(model, law=LAWS[law], surface=Plane(height, slope, uphill), scheme="explicit")
    found = wrench(
        sand, R @ position + [0, 0, height], times(q, quaternion), R @ velocity, R @ spin
    )
    expected = wrench(
        Sand(scene(""), law=LAWS[law], scheme="explicit"), position, quaternion, velocity, spin
    )
    expected = np.concatenate([R @ expected[:3], R @ expected[3:]])
    assert found == pytest.approx(expected, abs=1e-7 * np.linalg.norm(expected))


@pytest.mark.parametrize(
    "surface",
    [Plane(0.1, 0.2, 0.3), Bed("bed"), HeightField("dunes")],
    ids=lambda s: type(s).__name__,
)
def test_surfaces_are_frozen(surface):
    with pytest.raises(dataclasses.FrozenInstanceError):
        surface.height = surface.geom = "other"
    assert surface == dataclasses.replace(surface)


@compiled
def steep_probe(steep, point):
    """Of z = x, whose normal would be a unit vector if both were divided by sqrt(2)."""
    return point.x - point.z, vector(-1.0, 0.0, 1.0)


@compiled
def reversed_probe(steep, point):
    """The sand is above z = 0: depth grows along the normal."""
    return point.z, vector(0.0, 0.0, 1.0)


@compiled
def undefined_probe(steep, point):
    return math.sqrt(-1.0 - point.z * point.z), vector(0.0, 0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class Steep(Surface):
    probe = steep_probe

    def record(self, model):
        return np.zeros(1, [("nothing", float)])

    def tilt(self, model):
        return math.pi / 4


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, r"^Steep.probe: normals must have length 1, got 1.41421$"),
        ({"probe": reversed_probe}, r"^Steep.probe: depth must decrease along the normal, out"),
        ({"probe": undefined_probe}, r"^Steep.probe: depth must decrease along the normal, out"),
        ({"probe": None}, r"^Steep.probe must be compiled.* got None$"),
        ({"probe": steep_probe.py_func}, r"^Steep.probe must be compiled.* got .*steep_probe$"),
        (
            {"record": lambda self, model: (1.0,)},
            r"^Steep.record must .* shape \(1,\), got a tuple",
        ),
    ],
)
def test_a_custom_surface_is_checked(changed, said):
    surface = type("Steep", (Steep,), changed)()
    with pytest.raises(InputError, match=said):
        Sand(scene(""), law=LAWS["rft3d"], surface=surface)


def test_a_custom_surface_without_lift_cannot_be_tuned():
    with pytest.raises(InputError, match=r"^Steep cannot be raised: give it a method lift$"):
        Steep().lift(scene(""))


@pytest.mark.parametrize(
    ("degrees", "memory", "way"), [(20, None, 0.0), (30, None, 0.62), (25, True, 0.10)]
)
def test_how_far_a_flat_box_slides_down_a_slope(degrees, memory, way):
    """As docs/surfaces.md says [m]."""
    slope = math.radians(degrees)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body pos="{-0.025 * math.sin(slope)} 0 {0.025 * math.cos(slope)}"
        euler="0 {-degrees} 0"><freejoint/><geom type="box" size=".1 .1 .025" mass="5"/></body>
        </worldbody></mujoco>"""
    )
    sand, data = Sand(model, surface=Plane(slope=slope), memory=memory), mujoco.MjData(model)
    start = data.qpos[:3].copy()
    while data.time < 3.0:
        sand.step(data)
    assert np.linalg.norm(data.qpos[:3] - start) == pytest.approx(way, abs=0.005)
    assert abs(data.qvel).max() < 1e-9
