"""What was handed over in another's place gets a sentence, or is taken for what was meant."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mjgranular import (
    Bed,
    DistributedLinkLaw,
    HeightField,
    InputError,
    Plane,
    Rft2dLaw,
    Rft3dLaw,
    Sand,
    UnknownNameError,
    add_sand,
)
from mjgranular.law import get_law

XML = """
<mujoco>
  <worldbody>
    <body name="ball"><freejoint/><geom name="ball" size="0.1"/><geom size="0.05"/></body>
  </worldbody>
</mujoco>
"""
SAND = {"medium": "quikrete_medium"}


def model():
    return mujoco.MjModel.from_xml_string(XML)


def spec():
    return mujoco.MjSpec.from_string(XML)


MISTAKES = {
    "path for model": (lambda: Sand("robot.xml"), r"not 'robot.xml'; use MjModel.from_xml_path\("),
    "Path for model": (lambda: Sand(Path("robot.xml")), r"Path; use MjModel.from_xml_path\("),
    "spec for model": (lambda: Sand(spec()), r"use .* spec.compile\(\)"),
    "data for model": (lambda: Sand(mujoco.MjData(model())), "use .* or data.model"),
    "nothing for model": (lambda: Sand(None), "not None"),
    "model for spec": (lambda: add_sand(model()), "use .* or Sand for a compiled model"),
    "path for spec": (lambda: add_sand("a.xml"), r"'a.xml'; use MjSpec.from_file\("),
    "model for data": (lambda: Sand(model(), **SAND).step(model()), r"MjData\(model\)"),
    "nothing to report": (lambda: Sand(model(), **SAND).report(None), "not None"),
    "nothing to apply to": (lambda: Sand(model(), **SAND).apply("x"), "not 'x'"),
    "height for surface": (lambda: Sand(model(), surface=0.1, **SAND), r"0.1; use Plane\(height="),
    "name for surface": (lambda: Sand(model(), surface="bed", **SAND), r"bed geom=NAME"),
    "class for surface": (lambda: Sand(model(), surface=Plane, **SAND), "not the class Plane"),
    "the same for a spec": (lambda: add_sand(spec(), surface=0.1), r"0.1; use Plane\(height="),
    "words for resolution": (lambda: Sand(model(), resolution="fine", **SAND), "integer"),
    "half of a resolution": (lambda: Sand(model(), resolution=2.5, **SAND), "integer"),
    "text for height": (lambda: Plane("high"), "must be finite, got 'high'"),
    "number for a bed": (lambda: Sand(model(), surface=Bed(3), **SAND), "name of its geom"),
    "number for a field": (lambda: Sand(model(), surface=HeightField(3), **SAND), "name of its"),
    "geom beyond the last": (lambda: Sand(model(), geoms=7, **SAND), "geom number 7.*0 to 1"),
    "geom before the first": (lambda: Sand(model(), geoms=[-1], **SAND), "geom number -1"),
    "generator of geoms": (lambda: Sand(model(), geoms=(g for g in [1]), **SAND), "by a generator"),
    "text for pieces": (lambda: DistributedLinkLaw(1, 1, 1, 1, pieces="3"), "integer, not '3'"),
    "flag for a geom": (lambda: Sand(model(), geoms=[True], **SAND), "names or numbers"),
    "float for a body": (lambda: Sand(model(), bodies=1.0, **SAND), "names or numbers"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_get_a_sentence(mistake):
    make, said = MISTAKES[mistake]
    with pytest.raises(InputError, match=said):
        make()


@pytest.mark.parametrize("law", [Rft2dLaw, Rft3dLaw])
def test_laws_are_made_from_the_name_of_a_medium(law):
    assert get_law(None, "play_sand").name == "link"
    medium = {Rft2dLaw: "poppy_seed_loose", Rft3dLaw: "quikrete_medium"}[law]
    assert isinstance(law.from_medium(medium), law)


@pytest.mark.parametrize("geoms", [1, [1], "1", ["1"], np.int32(1)])
def test_geoms_go_by_number_too(geoms):
    assert set(Sand(model(), geoms=geoms, **SAND).elements["geom"]) == {1}


def test_geoms_go_by_number_in_mjcf():
    text = add_sand(spec(), geoms=[1], **SAND).config["geoms"]
    assert text == "1"


def test_a_name_that_is_a_number_is_a_name_first():
    named = XML.replace('name="ball" size', 'name="1" size')
    sand = Sand(mujoco.MjModel.from_xml_string(named), geoms=["1"], **SAND)
    assert set(sand.elements["geom"]) == {0}


def test_a_body_of_a_report_too_goes_by_name_first():
    bodies = "".join(
        f'<body {name} pos="{x} 0 1"><freejoint/><geom size="0.1"/></body>'
        for x, name in enumerate(("name='toe'", "", "name='2'"))
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    report = Sand(model, **SAND).report(mujoco.MjData(model))
    toe, unnamed, two = report.bodies
    assert report["toe"] is report["1"] is report[1] is toe
    assert report[2] is unnamed
    assert report["2"] is report["3"] is report[np.int64(3)] is two
    assert list(report) == ["toe", "2", "2"]
    assert "toe" in report
    assert "heel" not in report


def test_elements_of_a_report_have_ids_and_no_field_that_was_a_name():
    """Of 0.3.0's `element.body == "ball"` it would silently be false."""
    ball = model()
    report = Sand(ball, **SAND).report(mujoco.MjData(ball))
    element = report.elements[0]
    assert report.names.geoms[element.geom_id] == "ball"
    assert report.names.bodies[element.body_id] == "ball"
    for name in ("geom", "body"):
        with pytest.raises(AttributeError):
            getattr(element, name)


def test_of_many_names_the_nearest_are_told():
    geoms = "".join(
        f'<geom name="{word}_{n}" size="0.1"/>' for word in ("toe", "hand") for n in range(9)
    )
    xml = f"<mujoco><worldbody><body><freejoint/>{geoms}</body></worldbody></mujoco>"
    with pytest.raises(UnknownNameError, match=r"did you mean toe_3, .*There are 18 in all"):
        Sand(mujoco.MjModel.from_xml_string(xml), geoms=["toe3"], **SAND)
