"""Faces of rigid bodies: one body however it is cut into geoms, and shelter against grains."""

import csv
import itertools
import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjgranular import Sand
from mjgranular.shape import facets_from_model
from mjgranular.shape.rigid import exposures, in_own_frames
from mjgranular.shape.tessellation import at_corners

MOTIONS = {"x": (0.1, 0, 0), "y": (0, 0.1, 0), "up": (0, 0, 0.1), "down": (0, 0, -0.1)}
TANDEM = Path(__file__).parents[2] / "referee" / "data" / "tandem" / "upright.csv"


def model_of(geoms, asset="", joint="<freejoint/>"):
    return mujoco.MjModel.from_xml_string(
        f'<mujoco>{asset}<worldbody><body name="b" pos="0 0 -0.05">{joint}{geoms}</body>'
        "</worldbody></mujoco>"
    )


def forces(law, *args):
    """Forces on a body that moves, for each of `MOTIONS` [N], shape (4, 3)."""
    slides = "".join(
        f'<joint type="slide" axis="{axis}" armature="1e5"/>'
        for axis in ("1 0 0", "0 1 0", "0 0 1")
    )
    model = model_of(*args, joint=slides)
    sand, found = Sand(model, medium="quikrete_medium", law=law, scheme="implicit"), []
    for velocity in MOTIONS.values():
        data = mujoco.MjData(model)
        data.qvel[:] = velocity
        found.append(sand.report(data)["b"].force.copy())
    return np.array(found)


def bar(count, gap):
    """A bar of 100 x 20 x 10 mm, of boxes with gaps between them."""
    length = (0.1 - gap * (count - 1)) / count
    places = -0.05 + length / 2 + (length + gap) * np.arange(count)
    return "".join(f'<geom type="box" size="{length / 2} .01 .005" pos="{x} 0 0"/>' for x in places)


def along(found):
    """Resistance along the motion, for each motion [N]."""
    return np.array([-force @ np.sign(v) for force, v in zip(found, MOTIONS.values(), strict=True)])


@pytest.mark.parametrize(
    ("law", "gap"), [("rft3d", 0.0), ("rft3d", 1e-6), ("rft3d", 5e-4), ("rft3d_dynamic", 5e-4)]
)
def test_narrow_gaps_leave_a_bar_what_it_is(law, gap):
    ratio = along(forces(law, bar(12, gap))) / along(forces(law, bar(1, 0.0)))
    assert ratio == pytest.approx(np.ones(4), abs=0.02)


@pytest.mark.parametrize("depth", [1e-9, 0.005, 0.0133, 0.02])
def test_inertia_acts_on_what_is_in_the_sand(depth):
    # An upright plate of 40 x 40 mm at 2 m/s, cut coarsely and finely.
    plate = f'<geom type="box" size=".002 .02 .02" pos="0 0 {0.07 - depth}"/>'
    model = model_of(plate, joint='<joint type="slide" axis="1 0 0" armature="1e5"/>')
    data, found = mujoco.MjData(model), []
    data.qvel[0] = 2.0
    for resolution in (None, 64):
        sand = Sand(model, medium="quikrete_medium", resolution=resolution)
        found.append(-sand.report(data)["b"].force[0])
    assert found[0] == pytest.approx(found[1], rel=0.01, abs=1e-3)


@pytest.mark.parametrize("gap", [1e-5, 1e-3])
def test_a_slit_in_a_mesh_is_one_between_boxes(gap):
    corners = np.array([(x, y, z) for x in (0, 0.01) for y in (-0.02, 0.02) for z in (0, 0.04)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    aside = np.array([gap / 2, 0, 0])
    vertices = np.concatenate([corners - (0.01, 0, 0) - aside, corners + aside])
    faces = np.concatenate([faces, faces + 8])
    asset = (
        f'<asset><mesh name="m" inertia="exact" vertex="{" ".join(map(str, vertices.ravel()))}" '
        f'face="{" ".join(map(str, faces.ravel()))}"/></asset>'
    )
    boxes = "".join(
        f'<geom type="box" size=".005 .02 .02" pos="{x} 0 .02"/>'
        for x in (-0.005 - gap / 2, 0.005 + gap / 2)
    )
    areas = []
    for model in (model_of('<geom type="mesh" mesh="m"/>', asset), model_of(boxes)):
        facets = facets_from_model(model, range(model.ngeom))
        areas.append(facets["area"][np.abs(facets["normal"][:, 0]) > 0.9].sum())
    assert areas[0] == pytest.approx(areas[1], rel=0.02)


RADIUS, THICK, BROAD = 0.038, 0.004, 0.025


def leg_of_boxes(count):
    """A half circle of boxes."""
    text = ""
    for angle in math.pi * (np.arange(count) + 0.5) / count:
        x, z = RADIUS * math.cos(angle), RADIUS * math.sin(angle)
        text += (
            f'<geom type="box" size="{0.51 * RADIUS * math.pi / count} {BROAD / 2} {THICK / 2}" '
            f'pos="{x} 0 {z}" euler="0 {-math.degrees(angle) - 90} 0"/>'
        )
    return text


def leg_of_a_mesh(count=48):
    """The same half circle as one mesh: its asset and its geom."""
    turns = np.linspace(0.0, math.pi, count + 1)
    radii = (RADIUS + THICK / 2, RADIUS - THICK / 2)
    points = [
        (r * math.cos(a), y, r * math.sin(a))
        for a in turns
        for r in radii
        for y in (-BROAD / 2, BROAD / 2)
    ]
    quads = [(0, 1, 3, 2), (4 * count + 2, 4 * count + 3, 4 * count + 1, 4 * count)]
    for k in 4 * np.arange(count):
        quads += [(k, k + 4, k + 5, k + 1), (k + 3, k + 7, k + 6, k + 2)]
        quads += [(k + 1, k + 5, k + 7, k + 3), (k + 2, k + 6, k + 4, k)]
    faces = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))])
    corners = np.array(points)[faces]
    if np.einsum("ni,ni->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        faces = faces[:, ::-1]
    asset = (
        f'<asset><mesh name="leg" inertia="shell" vertex="{" ".join(map(str, np.ravel(points)))}" '
        f'face="{" ".join(map(str, faces.ravel()))}"/></asset>'
    )
    return '<geom type="mesh" mesh="leg"/>', asset


@pytest.mark.parametrize(("law", "count"), [("rft3d", 24), ("rft3d_dynamic", 12)])
def test_a_hollow_leg_of_boxes_is_one_of_a_mesh(law, count):
    ratio = along(forces(law, leg_of_boxes(count))) / along(forces(law, *leg_of_a_mesh()))
    assert ratio == pytest.approx(np.ones(4), abs=0.1)


def foot(count):
    """A foot of 60 x 60 x 20 mm of boxes side by side; of no box, a mesh."""
    if count == 0:
        corners = [(x, y, z) for x in (-0.03, 0.03) for y in (-0.03, 0.03) for z in (0, 0.02)]
        text = " ".join(map(str, np.ravel(corners)))
        return '<geom type="mesh" mesh="f" mass="1"/>', f'<mesh name="f" vertex="{text}"/>'
    half = 0.03 / count
    places = (2 * np.arange(count) + 1) * half - 0.03
    return "".join(
        f'<geom type="box" pos="{x} {y} .01" size="{half} {half} .01" mass="{1 / count**2}"/>'
        for x in places
        for y in places
    ), ""


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.3, 2.0])
def test_a_foot_in_pieces_sinks_as_one(speed):
    depths = []
    for count in (1, 2, 6, 0):
        geoms, mesh = foot(count)
        model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option timestep="0.001"/><asset>{mesh}</asset>
          <worldbody><body><joint type="slide" axis="0 0 1"/>{geoms}</body></worldbody>
        </mujoco>""")
        data, sand = mujoco.MjData(model), Sand(model, medium="quikrete_medium")
        data.qvel[0] = -speed
        while data.time < 0.3:
            sand.step(data)
        depths.append(-data.qpos[0])
    assert depths == pytest.approx([depths[0]] * 4, rel=0.015)


def test_plates_in_tandem_against_simulated_grains():
    # Fitted: one constant, to the pairs. The scatter of the grains themselves is 0.07.
    def row_of(places):
        text = '<geom type="box" size=".002 .008 .008" pos="{} 0 0"/>'
        return along(forces("rft3d", "".join(text.format(x) for x in places)))[0]

    with TANDEM.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if int(row["plates"]) > 1]
    assert {row["plates"] for row in rows} == {"2", "4"}
    alone, wrong = row_of([0.0]), []
    for row in rows:
        step = 0.004 + 0.016 * float(row["gap over length"])
        found = row_of(step * np.arange(int(row["plates"]))) / alone
        wrong.append(found - float(row["force over one plate's"]))
    assert math.sqrt(np.mean(np.square(wrong))) < 0.1


def exposed(geoms, joint="<freejoint/>"):
    """Facets, and the share of the area of each that meets sand, for a model of geoms."""
    model = model_of(geoms, joint=joint)
    facets = facets_from_model(model, range(model.ngeom), sheltered="keep")
    skins = at_corners(facets["point"], facets["normal"], facets["edges"])
    return facets, exposures(model, in_own_frames(model), facets, skins)


@pytest.mark.parametrize("joint", ["<freejoint/>", '<joint axis="0 1 0" pos="0 0 .5"/>'])
def test_walls_that_touch_shelter_as_one(joint):
    plate = '<geom type="box" size=".001 .01 .01"/>'
    walls = {
        "one": '<geom type="box" size=".01 .01 .01" pos=".03 0 0"/>',
        "touching": "".join(
            f'<geom type="box" size=".0025 .01 .01" pos="{x} 0 0"/>'
            for x in (0.0225, 0.0275, 0.0325, 0.0375)
        ),
        "overlapping": "".join(
            f'<geom type="box" size=".005 .01 .01" pos="{x} 0 0"/>' for x in (0.025, 0.029, 0.035)
        ),
        "a hair apart": "".join(
            f'<geom type="box" size=".00495 .01 .01" pos="{x} 0 0"/>' for x in (0.02495, 0.03505)
        ),
    }
    found = {}
    for name, wall in walls.items():
        facets, share = exposed(plate + wall, joint)
        front = (facets["geom"] == 0) & (facets["normal"][:, 0] > 0.9)
        found[name] = float(share[front].mean())
    assert 0.2 < found["one"] < 0.6
    assert list(found.values()) == pytest.approx([found["one"]] * len(walls), abs=0.01)


def lathe(*profile, at=(0.0, 0.0, 0.0), turns=24):
    """Triangles of a ring or, from and to the axis, a solid; counter-clockwise from outside."""
    angles = 2 * math.pi * np.arange(turns + 1) / turns
    grid = [[(r * math.cos(a), r * math.sin(a), z) for a in angles] for r, z in profile]
    a, b = np.array(grid)[:-1], np.array(grid)[1:]
    halves = [(a[:, :-1], a[:, 1:], b[:, 1:]), (a[:, :-1], b[:, 1:], b[:, :-1])]
    corners = np.concatenate([np.stack(half, axis=2).reshape(-1, 3, 3) for half in halves])
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners[np.linalg.norm(doubled, axis=1) > 1e-12] + at


def mesh_of(*parts):
    """Asset and geom of one mesh of these triangles."""
    corners = np.concatenate(parts)
    vertices, faces = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    text = [" ".join(map(str, values.ravel())) for values in (vertices, faces)]
    mesh = f'<mesh name="{{0}}" inertia="shell" vertex="{text[0]}" face="{text[1]}"/>'
    return mesh, '<geom type="mesh" mesh="{0}"/>'


POT = [(0.0, -0.05), (0.05, -0.05), (0.05, 0.05), (0.048, 0.05), (0.048, -0.048), (0.0, -0.048)]
SCREW = [(0.0, -0.005), (0.005, -0.005), (0.005, 0.005), (0.0, 0.005)]
PLACES = 0.024 * np.array([*itertools.product((-1, 0, 1), (-1, 0, 1), (-1.5, -0.5, 0.5))])
SHEET = [(0.0, 0.0), (0.05, 0.0), (0.05, 5e-4), (0.0, 5e-4)]


@pytest.mark.parametrize(
    "meshes",
    [
        # Screws in a pot that is open at the top: the pot's outside, and little of the rest.
        [[lathe(*POT)], [lathe(*SCREW, at=at) for at in PLACES]],
        [[lathe(*POT), *[lathe(*SCREW, at=at) for at in PLACES]]],
        # Two sheets, 4 mm apart: their outsides.
        [[lathe(*SHEET), lathe(*SHEET, at=(0, 0, 0.0045))]],
    ],
)
def test_shelter_within_meshes_is_alike_at_all_resolutions(meshes):
    pairs = [mesh_of(*parts) for parts in meshes]
    asset, geoms = (
        "".join(t.format(k) for k, t in enumerate(ts)) for ts in zip(*pairs, strict=True)
    )
    model = model_of(geoms, f"<asset>{asset}</asset>")
    for resolution in (6, 24):
        skins = [
            facets_from_model(model, range(model.ngeom), resolution, sheltered=sheltered)["area"]
            for sheltered in ("keep", "drop")
        ]
        assert skins[1].sum() / skins[0].sum() == pytest.approx(0.52, abs=0.03), resolution


RIM, GROUSERS, HIGH = 0.1, 12, 0.018  # a wheel: radius [m], number, and height of grousers [m]


def wheel():
    """A wheel of 80 mm width."""
    angles = 2 * math.pi * np.arange(GROUSERS) / GROUSERS
    middle = RIM + HIGH / 2
    return f'<geom type="cylinder" size="{RIM} .04" euler="90 0 0" mass=".8"/>' + "".join(
        f'<geom type="box" size="{HIGH / 2} .04 .003" mass=".01" euler="0 {np.degrees(a) - 90} 0" '
        f'pos="{middle * math.sin(a)} 0 {middle * math.cos(a)}"/>'
        for a in angles
    )


def test_grousers_shelter_each_other_along_the_rim():
    flanks, turns = {}, '<joint axis="0 1 0"/>'
    carriage = f'<joint type="slide" axis="1 0 0"/><joint type="slide"/>{turns}'
    for joint in ("<freejoint/>", turns, '<joint axis="0 -1 0"/>', carriage):
        facets, share = exposed(wheel(), joint)
        flank = (facets["geom"] > 0) & (facets["area"] > 1e-4)
        around = np.cross(facets["point"], (0.0, 1.0, 0.0))
        flank &= np.abs((facets["normal"] * around).sum(axis=1)) > 0.9 * RIM
        flanks[joint] = share[flank]
    free, turning, mirrored, carried = flanks.values()
    assert turning == pytest.approx(mirrored, abs=1e-9)
    assert turning == pytest.approx(carried, abs=1e-9)
    assert turning.max() < 0.5 < free.min()  # straight rays miss the next grouser
    assert np.ptp(turning.reshape(GROUSERS, -1), axis=0) == pytest.approx(0, abs=0.05)


@pytest.mark.slow
def test_a_wheel_pulls_no_more_than_sand_bears():
    # Others measured pulls of 0.2 to 0.3 of the load at high slip; a wheel as smooth and as large
    # as the circle of the tips, with the sand's own friction, pulls 0.31 here.
    load, pull = 40.0, {}
    for slip in (0.2, 0.8):
        model = mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <option timestep="0.002" integrator="implicitfast"/>
          <worldbody><body pos="0 0 {RIM + HIGH}">
            <joint name="x" axis="1 0 0" type="slide"/>
            <joint axis="0 0 1" type="slide" damping="20"/>
            <inertial mass="{load / 9.81 - 0.92}" pos="0 0 0" diaginertia=".1 .1 .1"/>
            <body><joint name="w" axis="0 1 0" armature=".01"/>{wheel()}</body>
          </body></worldbody>
          <actuator><velocity joint="x" kv="5000"/><velocity joint="w" kv="500"/></actuator>
        </mujoco>""")
        data, sand, found = mujoco.MjData(model), Sand(model, medium="quikrete_medium"), []
        while data.time < 6:
            data.ctrl[:] = min(1.0, data.time) * np.array([(RIM + HIGH) * (1 - slip), 1.0])
            sand.step(data)
            if data.time > 3:
                found.append(-data.actuator_force[0])
        pull[slip] = np.mean(found) / load
    assert 0.1 < pull[0.2] < pull[0.8] < 0.45


def test_widths_are_those_of_faces():
    def widths(geoms):
        model = model_of(geoms)
        facets = facets_from_model(model, range(model.ngeom))
        return facets["face"], np.abs(facets["normal"]).argmax(axis=1)

    for geoms in (bar(1, 0.0), bar(5, 0.0), bar(10, 1e-4)):
        face, axis = widths(geoms)
        assert face[axis == 0] == pytest.approx(0.01, rel=0.02)
        assert face[axis == 1] == pytest.approx(0.01, rel=0.02)
        assert face[axis == 2] == pytest.approx(0.02, rel=0.02)


def test_layers_are_thick_before_what_is_long():
    def ratio(geoms):
        model = model_of(geoms)
        facets = facets_from_model(model, range(model.ngeom))
        side = (abs(facets["normal"][:, 0]) < 0.01) & (abs(facets["face"] - 0.02) < 1e-6)
        return facets["layer"][side] / 0.02

    rod = '<geom type="capsule" size="0.01" fromto="{} 0 0 {} 0 0"/>'
    one, cut = rod.format(0, 0.18), "".join(rod.format(x, x + 0.06) for x in (0, 0.06, 0.12))
    slices = '<geom type="cylinder" size="0.01 0.005" pos="{} 0 0" euler="0 90 0"/>'
    discs = "".join(slices.format(x) for x in np.arange(0.005, 0.2, 0.01))
    far = one + rod.format(0.3, 0.5) + '<geom type="capsule" size="0.003" fromto="0 0 0 -1 0 0"/>'
    for geoms in (one, cut, discs, far):  # of a rod of ten diameters
        assert ratio(geoms)[0] == pytest.approx(1 + 1.36 * 0.9, rel=0.01)
    assert ratio('<geom size="0.01"/>') == pytest.approx(1.0)
    plate = '<geom type="box" size="0.02 0.01 0.005"/>'
    assert ratio(plate) == pytest.approx(1 + 0.73 * 0.5, rel=0.01)


def test_a_capsule_is_a_cylinder_with_two_balls():
    whole = '<geom type="capsule" size="0.02 0.08" euler="0 90 0" mass="0.1"/>'
    cut = '<geom type="cylinder" size="0.02 0.08" euler="0 90 0" mass="0.06"/>' + "".join(
        f'<geom size="0.02" pos="{x} 0 0" mass="0.02"/>' for x in (-0.08, 0.08)
    )
    thick = []
    for geoms in (whole, cut):
        facets = facets_from_model(model_of(geoms), range(3 if geoms == cut else 1), 24)
        for end in (True, False):
            mine = facets[(np.abs(facets["point"][:, 0]) > 0.08) == end]
            thick.append(mine["area"] @ mine["layer"] / mine["area"].sum())
    assert thick[2:] == pytest.approx(thick[:2], rel=0.02)


@pytest.mark.parametrize("count", [4, 16])
def test_a_mesh_in_wedges_is_as_wide_as_in_one(count):
    turns = 2 * math.pi * np.arange(49) / 48

    def means(*edges):
        """Area and mean widths of the level faces and of the rim of a disc, cut at these edges."""
        asset = geoms = ""
        for first, end in itertools.pairwise(edges):
            rim = np.c_[np.cos(turns[first : end + 1]), np.sin(turns[first : end + 1])] * 0.05
            rim = np.vstack([rim, (0.0, 0.0)])
            points = [(x, y, z) for z in (-0.01, 0.01) for x, y in rim]
            asset += f'<mesh name="{first}" vertex="{" ".join(map(str, np.ravel(points)))}"/>'
            geoms += f'<geom type="mesh" mesh="{first}"/>'
        model = model_of(geoms, f"<asset>{asset}</asset>")
        facets = facets_from_model(model, range(model.ngeom))
        for part in (level := abs(facets["normal"][:, 2]) > 0.9, ~level):
            areas = facets["area"][part]
            yield areas.sum()
            yield from (areas @ facets[name][part] / areas.sum() for name in ("face", "layer"))

    pieces = means(*range(0, 49, 48 // count))
    assert list(pieces) == pytest.approx(list(means(0, 48)), rel=0.01)


def test_meshes_apart_are_not_one_body():
    turns = 2 * math.pi * np.arange(24) / 24
    rim = 0.01 * np.c_[np.cos(turns), np.sin(turns)]
    points = [(x, y, z) for x, y in rim for z in (-0.1, 0.1)]
    asset = f'<asset><mesh name="rod" vertex="{" ".join(map(str, np.ravel(points)))}"/>'
    asset += f'<mesh name="far" vertex="{" ".join(map(str, 10 * np.ravel(points)))}"/></asset>'
    geom = '<geom type="mesh" mesh="{}" pos="{} 0 {}" euler="0 {} 0"/>'

    def faces(*geoms):
        model = model_of("".join(geom.format(*numbers) for numbers in geoms), asset)
        facets = facets_from_model(model, range(model.ngeom))
        return [facets[name][facets["geom"] == 0].mean() for name in ("face", "layer", "flat")]

    alone = faces(("rod", 0, 0, 45))
    assert faces(("rod", 0, 0, 45), ("rod", 0.05, -0.05, 45)) == pytest.approx(alone, rel=0.05)
    apart = faces(("rod", 0, 0, 0), ("rod", 0.04, 0, 0), ("far", 5, 0, 0))
    assert apart == pytest.approx(alone, rel=0.05)
    on_a_foot = faces(("rod", 0, 0, 0), ("far", 0, -1.1, 0))  # which is ten times as large
    assert on_a_foot[:2] == pytest.approx(alone[:2], rel=0.05)


def test_sides_of_two_bodies_do_not_shelter_each_other():
    model = mujoco.MjModel.from_xml_string("""
    <mujoco><worldbody>
      <body name="a"><freejoint/><geom type="box" size=".002 .02 .02"/></body>
      <body name="b" pos=".006 0 0"><freejoint/><geom type="box" size=".002 .02 .02"/></body>
    </worldbody></mujoco>""")
    facets = facets_from_model(model, range(2))
    areas = [facets["area"][facets["body"] == body].sum() for body in (1, 2)]
    assert areas == pytest.approx([2 * (0.04 * 0.04 + 2 * 0.04 * 0.004)] * 2, rel=1e-9)
