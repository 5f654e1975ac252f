"""Sizes, resolutions, states and times that cannot be computed with: one sentence, or a number."""

from __future__ import annotations

import contextlib
import math
import tracemalloc

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mjgranular import (
    Bed,
    DepthVelocityLaw,
    GranularError,
    HeightField,
    InputError,
    Sand,
    UnstableError,
)
from mjgranular.engine import add_sand
from mjgranular.law import get_law
from mjgranular.medium import get_medium
from mjgranular.shape import facets_from_model, sizes

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

# How many sizes a geom has.
GEOMS = {"capsule": 2, "sphere": 1, "cylinder": 2, "ellipsoid": 3, "box": 3}
RODS = ("capsule", "cylinder")
LAWS = {
    "link": "play_sand",
    "link_distributed": "play_sand",
    "rft3d": "quikrete_medium",
    "depth_velocity": None,
}


def text_of(*geoms, world=("", "")):
    inside = "".join(
        f'<geom name="{kind} {i}" type="{kind}" size="{" ".join(map(repr, size))}" mass="1"/>'
        for i, (kind, size) in enumerate(geoms)
    )
    assets, fixed = world
    return (
        f'<mujoco><option timestep="1e-3"/>{assets}<worldbody>{fixed}'
        f'<body name="b"><freejoint/>{inside}</body></worldbody></mujoco>'
    )


def model_of(*geoms, **options):
    return mujoco.MjModel.from_xml_string(text_of(*geoms, **options))


def law_of(name):
    if name == "depth_velocity":
        return DepthVelocityLaw(stiffness=100.0)
    return get_law(name, get_medium(LAWS[name]))


@pytest.mark.parametrize("size", [1e20, 1e160, 1e-160, 1e-20])
@pytest.mark.parametrize("law", LAWS)
def test_a_size_beyond_reason_is_named(law, size):
    model = model_of(("capsule", (0.1, 0.1)))
    model.geom_size[0] = size
    with pytest.raises(InputError, match=r"'capsule 0' has a half extent of .*e[+-]\d+ m: it must"):
        Sand(model, law=law_of(law))


@pytest.mark.parametrize("kind", GEOMS)
def test_the_bounds_themselves_are_within(kind):
    for size in (sizes.SMALLEST, 0.4 * sizes.LARGEST):
        model = model_of((kind, (0.1,) * GEOMS[kind]))
        model.geom_size[0, : GEOMS[kind]] = size
        for law in LAWS:
            if kind in RODS or not law.startswith("link"):
                elements = law_of(law).elements(model, [0], None)
                assert all(np.isfinite(elements[name]).all() for name in elements.dtype.names or ())


size = st.one_of(st.just(0.05), st.floats(-200, 200).map(lambda x: 10.0**x), st.floats(1e-12, 1e12))


@settings(max_examples=100)
@given(
    law=st.sampled_from(sorted(LAWS)),
    kinds=st.lists(st.sampled_from(sorted(GEOMS)), min_size=1, max_size=2),
    numbers=st.lists(size, min_size=6, max_size=6),
    place=st.floats(-300, 300).map(lambda x: 10.0**x),
    resolution=st.sampled_from([None, -1, 0, 1, 2, 4, 10**6, 2**63, 10**30]),
)
def test_elements_are_numbers_or_refused(law, kinds, numbers, place, resolution):
    model = model_of(*((kind, (0.1,) * GEOMS[kind]) for kind in kinds))
    model.geom_size[: len(kinds)] = np.reshape(numbers[: 3 * len(kinds)], (-1, 3))
    model.geom_pos[0, 0] = place
    try:
        elements = law_of(law).elements(model, range(len(kinds)), resolution)
    except GranularError:
        return
    assert len(elements) <= sizes.MOST_ELEMENTS
    assert all(np.isfinite(elements[name]).all() for name in elements.dtype.names or ())


@pytest.mark.parametrize(
    ("law", "resolution", "text"),
    [
        ("link_distributed", 10**9, "at most 10000, not 1000000000"),
        ("link_distributed", 10**30, "at most 10000"),
        ("link_distributed", 0, "at least 1"),
        ("link_distributed", 2.5, "an integer, not 2.5"),
        ("rft3d", 10**9, "at most 200"),
        ("rft3d", 1, "at least 2"),
        ("rft3d", "12", "an integer, not '12'"),
    ],
)
def test_a_resolution_beyond_reason_is_told(law, resolution, text):
    model = model_of(("capsule", (0.1, 0.1)))
    with pytest.raises(InputError, match=f"the resolution must be {text}"):
        Sand(model, medium=LAWS[law], law=law, resolution=resolution)


def test_within_the_engine_it_is_told_too():
    spec = mujoco.MjSpec.from_string(text_of(("capsule", (0.1, 0.1))))
    add_sand(spec, law="link_distributed", resolution=10**5)
    with pytest.raises(ValueError, match="the resolution must be at most 10000"):
        spec.compile()


def test_too_many_elements_of_many_geoms_are_told():
    model = model_of(*(("capsule", (0.1, 0.1)) for _ in range(101)))
    with pytest.raises(InputError, match="1,010,000 elements, more than 1,000,000"):
        Sand(model, law="link_distributed", resolution=10_000)


@pytest.mark.slow
def test_geoms_are_cut_one_by_one():
    def peak(count):
        model = model_of(*(("sphere", (0.1,)) for _ in range(count)))
        tracemalloc.start()
        facets_from_model(model, range(count), 24)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    assert peak(20) < 3 * peak(1)


@pytest.mark.parametrize("length", [1e20, 1e-160, 1e308])
def test_sand_beyond_reason_is_named(length):
    assets = '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>'
    geoms = '<geom name="bed" type="box" size="1 1 1"/><geom name="h" type="hfield" hfield="h"/>'
    model = model_of(("sphere", (0.1,)), world=(assets, geoms))
    model.geom_size[0, 1] = length
    model.hfield_size[0, 1] = length
    for surface, what in ((Bed("bed"), "the bed 'bed'"), (HeightField("h"), "of geom 'h'")):
        with pytest.raises(InputError, match=f"{what} has a half extent of .* m: it must be from"):
            Sand(model, law=law_of("depth_velocity"), surface=surface)


@pytest.mark.parametrize("heights", [math.nan, math.inf])
def test_heights_may_come_later(heights):
    world = (
        '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>',
        '<geom name="h" type="hfield" hfield="h"/>',
    )
    model = model_of(("sphere", (0.1,)), world=world)
    model.hfield_data[::2] = heights
    sand = Sand(model, law=law_of("depth_velocity"), surface=HeightField("h"), scheme="explicit")
    model.hfield_data[:] = 0.0
    sand.step(mujoco.MjData(model))


@pytest.mark.parametrize("timestep", [0.0, 1e-310, 1e300, math.nan])
def test_a_time_step_beyond_reason_is_not_what_is_told(timestep):
    model = model_of(("capsule", (0.1, 0.1)))
    sand = Sand(model, law="link", scheme="explicit")
    data = mujoco.MjData(model)
    sand.step(data)
    model.opt.timestep = timestep
    data.qpos[2] = math.nan
    with pytest.raises(GranularError, match=r"NaN|time step|timestep"):
        sand.step(data)


@pytest.mark.parametrize("number", [1e10, 1e160, 1e200, 1e308, math.inf, math.nan])
@pytest.mark.parametrize("law", ["link", "depth_velocity"])
def test_a_report_of_a_state_that_left_reason(law, number):
    model = model_of(("capsule", (0.1, 0.1)))
    sand = Sand(model, law=law_of(law), scheme="explicit")
    for name in ("qpos", "qvel"):
        for sign in (-1, 1):
            data = mujoco.MjData(model)
            getattr(data, name)[:3] = sign * number
            with contextlib.suppress(UnstableError):
                sand.report(data)
