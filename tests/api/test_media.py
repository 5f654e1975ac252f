"""Media: where their numbers come from, files of one's own, laws and media from outside."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest

import mjgranular as mg
from mjgranular import InputError, Medium, Quantity, Sand, UnknownNameError
from mjgranular.kernel import compiled
from mjgranular.law.rft import RftLaw
from mjgranular.law.rft3d import LEVEL_PLATE
from mjgranular.medium import read_medium
from mjgranular.medium.file import EXAMPLE

PUBLISHED = json.loads(
    (Path(__file__).parents[1] / "data" / "resistive_force_theory.json").read_text(encoding="utf-8")
)
NAMES = [
    *("play_sand", "quikrete_medium", "glass_beads", "poppy_seed_loose", "poppy_seed_close"),
    *("glass_beads_loose", "glass_beads_close", "glass_beads_3mm_close"),
    *("yuma_sand", "twentynine_palms_sand"),
]


def body(geom="type='capsule' size='.01 .1'"):
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><body name='body'><freejoint/><geom {geom}/></body></worldbody>"
        "</mujoco>"
    )


# Those that come with the package


def quantities(medium):
    """Every number of a medium, by name."""
    found = {"density": medium.density}
    if medium.grain is not None:
        found["grain"] = medium.grain
    for law, constants in medium.constants.items():
        found |= {f"{law}.{key}": value for key, value in constants.items()}
    return found


def test_the_media_asked_for_are_there():
    assert set(NAMES) <= set(mg.media)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_has_a_source_and_a_unit(name):
    dimensionless = {"eta_d", "eta_h", "eta_v", "exponent", "scale"}
    dimensionless |= {"internal_friction", "surface_friction"}
    for key, quantity in quantities(mg.media[name]).items():
        assert math.isfinite(quantity.value)
        # A publication with its place in it, or an honest word.
        assert any(
            sign in quantity.source for sign in ("(20", "section", "chosen, not measured", "guess")
        ), key
        assert (quantity.unit == "") == (key.rpartition(".")[2] in dimensionless), key


@pytest.mark.filterwarnings("ignore:medium .* brings the law 'link'")
@pytest.mark.parametrize("name", NAMES)
def test_every_medium_serves_its_own_law_and_those_it_has_constants_for(name):
    medium = mg.media[name]
    assert medium.name == name
    assert medium.title
    assert Sand(body(), medium=name).law.name == medium.default_law == medium.laws[0]
    for law in medium.constants:
        assert Sand(body(), medium=name, law=law, scheme="explicit").law == mg.laws[
            law
        ].from_medium(medium)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("poppy_seed_loose", "poppy seed, loose"),
        ("poppy_seed_close", "poppy seed, close"),
        ("glass_beads_loose", "glass, 0.3 mm, loose"),
        ("glass_beads_close", "glass, 0.3 mm, close"),
        ("glass_beads_3mm_close", "glass, 3 mm, close"),
        ("play_sand", "generic"),
        ("glass_beads", "generic"),
        ("yuma_sand", "generic"),
        ("twentynine_palms_sand", "generic"),
    ],
)
def test_coefficients_are_the_published(name, key):
    planar = PUBLISHED["planar"]
    constants = mg.media[name].constants_for("rft2d")
    assert [constants[k] for k in planar["keys"]] == planar["sets"][key]
    scales = {"play_sand": 3.75, "glass_beads": 0.33}
    scales |= {"yuma_sand": 0.691, "twentynine_palms_sand": 0.888}
    assert constants.get("scale") == scales.get(name)


@pytest.mark.parametrize(
    ("name", "plate", "density", "repose"),
    [
        ("poppy_seed_loose", 0.351, 638, 36),
        ("poppy_seed_close", 0.558, 682, 47),
        ("glass_beads_loose", 0.24, 1479, 25),
        ("glass_beads_close", 0.40, 1581, 35),
        ("glass_beads_3mm_close", 0.29, 1606.5, 21),
    ],
)
def test_a_level_plate_is_resisted_as_measured(name, plate, density, repose):
    law = mg.Rft3dLaw.from_medium(name)
    assert mg.media[name].density.value == pytest.approx(density, rel=1e-3)
    assert law.density == mg.media[name].density.value
    assert math.degrees(math.atan(law.internal_friction)) == pytest.approx(repose)
    assert LEVEL_PLATE * 9.81e-6 * law.stiffness == pytest.approx(plate)


@pytest.mark.parametrize("name", NAMES)
def test_a_law_without_constants_is_told_those_with(name):
    medium = mg.media[name]
    known = sorted(medium.constants)
    for law in ("link", "rft2d", "rft3d", "depth_velocity"):
        if law in known:
            continue
        with pytest.raises(UnknownNameError) as caught:
            Sand(body(), medium=name, law=law, scheme="explicit")
        assert list(caught.value.known) == known
        for word in (name, law, *known):
            assert word in str(caught.value)


# Files


@pytest.fixture
def write(tmp_path):
    def write(text, name="sand.yaml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_the_example_is_a_medium(write):
    medium = read_medium(write(EXAMPLE))
    assert medium.name == "my_sand"
    assert medium.density == Quantity(1500.0, "kg/m^3", "weighed")
    assert medium.grain is None
    assert medium.constants_for("link") == {
        "eta_d": 6.5,
        "eta_h": 8.0,
        "eta_v": 22.0,
        "exponent": 1.1,
    }
    assert {q.source for q in medium.constants["link"].values()} == {"guessed"}


@pytest.mark.filterwarnings("ignore:medium .* brings the law 'link'")
@pytest.mark.parametrize("name", ["sand.yaml", "sand.yml"])
def test_a_file_is_taken_where_a_name_is(write, name):
    path = write(EXAMPLE + "grain: {value: 0.0003, unit: m, source: sieved}\n", name)
    sand = Sand(body(), medium=str(path), scheme="explicit")
    assert sand.medium == read_medium(path)
    assert sand.medium.grain.value == 3e-4
    assert sand.law == mg.LinkLaw(6.5, 8, 22, 1.1)
    assert "my_sand" not in mg.media  # read, not registered


@pytest.mark.filterwarnings("ignore:medium .* brings the law 'link'")
def test_a_path_is_a_file_too(write):
    assert Sand(body(), medium=write(EXAMPLE), scheme="explicit").medium.name == "my_sand"


def test_file_for_the_spatial_law(write):
    path = write("""
        name: quikrete_again
        title: copied
        density: {value: 1550, unit: kg/m^3, source: PNAS}
        default_law: rft3d_dynamic
        constants:
          rft3d:
            density: {value: 1550, unit: kg/m^3, source: PNAS}
            internal_friction: {value: 0.6745085, source: PNAS}
            surface_friction: {value: 0.4, source: chosen}
        """)
    model = body("type='sphere' size='.05'")
    data = mujoco.MjData(model)
    data.qvel[2] = -0.1
    ours, theirs = (
        Sand(model, medium=m).report(data).bodies[0].force for m in (str(path), "quikrete_medium")
    )
    assert ours == pytest.approx(theirs, rel=1e-6)
    assert ours[2] > 1


DENSITY = "density: {value: 1500, unit: kg/m^3, source: weighed}"
ETA_D = "eta_d: {value: 6.5, source: guessed}"
RANGE = "from 10 to 25000 kg/m\\^3"


def changed(old, new):
    assert old in EXAMPLE
    return EXAMPLE.replace(old, new)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (changed("name: my_sand\n", ""), "a medium needs name"),
        (changed(DENSITY + "\n", ""), "a medium needs density"),
        (changed("default_law: link\n", ""), "a medium needs default_law"),
        (EXAMPLE[: EXAMPLE.index("constants")], "a medium needs constants"),
        (EXAMPLE + DENSITY + "\n", "a key stands twice"),
        (EXAMPLE + "colour: red\n", "a medium has no key 'colour'; there are: .*grain"),
        (changed("value: 1500", "value: heavy"), "density.value must be a number, .*got 'heavy'"),
        (changed("value: 1500", "value: true"), "density.value must be a number, .*got 'true'"),
        (changed("value: 1500", "value: [1500]"), "density.value must be a number"),
        (changed("value: 1500", "value:"), "density.value must be a number, .*got ''"),
        (changed("value: 1500", "value: .nan"), "density.value must be a number"),
        (changed("value: 1500", "value: .inf"), "density.value must be a number"),
        (changed("value: 1500", "value: -1500"), f"density must be {RANGE}, not -1500"),
        (changed("value: 1500", "value: 1.5"), f"density must be {RANGE}, not 1.5"),
        (changed(DENSITY, "density: 1500"), r"density must be \{value: NUMBER, .*not '1500'"),
        (changed(ETA_D, "eta_d: 6.5"), r"constants.link.eta_d must be \{value: NUMBER"),
        (changed(ETA_D, "eta_d: {value: 6.5}"), r"constants.link.eta_d must be .*source"),
        (changed(ETA_D, "eta_d: {value: x, source: y}"), "constants.link.eta_d.value must be a n"),
        (changed(ETA_D, "eta_d: {value: .nan, source: y}"), "link.eta_d.value must be a number"),
        (changed("default_law: link", "default_law: rft3d"), "'rft3d' has no constants; .*link"),
        (changed("  link:", "  lnik:"), "'link' has no constants; it has those of: lnik"),
        (EXAMPLE[: EXAMPLE.index("  link:")] + "  link: 3\n", "constants.link must map names"),
        (EXAMPLE[: EXAMPLE.index("constants")] + "constants: 3\n", "constants must map names"),
        (EXAMPLE + "grain: {value: 3, unit: m, source: y}\n", "grain size must be from 1e-06 to 0"),
        (EXAMPLE + "grain: {value: .nan, unit: m, source: y}\n", "grain.value must be a number"),
        (EXAMPLE + "grain: 3\n", "grain must be "),
        (EXAMPLE + "grain: {value: 0.05, unit: cm, source: y}\n", "grain must be in m, not 'cm'"),
        (changed("kg/m^3", "g/l"), "density must be in kg/m\\^3, not 'g/l'"),
        ("- sand\n- more sand\n", "a medium must be a mapping with name, title"),
        ("", "a medium must be a mapping"),
        ("name: [", "is not YAML"),
        ("name: \x00", "is not YAML"),
    ],
)
def test_a_file_that_is_no_medium(write, text, message):
    with pytest.raises(InputError, match=message) as caught:
        Sand(body(), medium=str(write(text)), scheme="explicit")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        # Known when the law is made: a medium may have constants for a law of someone else's.
        ("value: 6.5", "value: -6.5", "LinkLaw: eta_d must be finite and not negative, not -6.5"),
    ],
)
def test_constants_that_the_law_refuses(write, old, new, message):
    with pytest.raises(InputError, match=message):
        Sand(body(), medium=str(write(changed(old, new))), scheme="explicit")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("    " + ETA_D + "\n", "", "eta_d"),
        (ETA_D, ETA_D + "\n    eta_x: {value: 1, source: y}", "eta_x"),
    ],
    ids=["missing", "unknown"],
)
def test_constants_that_the_law_does_not_have(write, old, new, key):
    with pytest.raises(InputError, match=key):
        Sand(body(), medium=str(write(changed(old, new))), scheme="explicit")


def test_numbers_as_people_write_them(write):
    path = write(EXAMPLE + "grain: {value: 1e-3, unit: m, source: sieved}\n")
    assert read_medium(path).grain.value == 1e-3


def test_no_file(tmp_path):
    path = tmp_path / "nowhere.yaml"
    with pytest.raises(InputError, match=r"cannot read the medium .*nowhere.yaml: No such file"):
        Sand(body(), medium=str(path), scheme="explicit")
    folder = tmp_path / "folder.yaml"
    folder.mkdir()
    with pytest.raises(InputError, match="cannot read the medium"):
        Sand(body(), medium=str(folder), scheme="explicit")


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "sand.yaml"
    path.write_bytes(b"name: \xff\xfe")
    with pytest.raises(InputError, match="is not YAML"):
        read_medium(path)


# From outside


@compiled
def syrup_stress(law, g, n, u, z):
    """Against the motion, the same for every face."""
    return -law.strength * u


@dataclasses.dataclass(frozen=True)
class SyrupLaw(RftLaw):
    name: ClassVar[str] = "test_syrup"
    title: ClassVar[str] = "one strength for every face"
    citation: ClassVar[str] = "invented for a test"
    stress: ClassVar[Any] = syrup_stress

    strength: float
    inertia: float = 0.0
    rise: bool = False

    @classmethod
    def from_medium(cls, medium):
        return cls(**medium.constants_for(cls.name))

    def parameters(self, medium):
        fields = [(key, np.float64) for key in ("strength", "inertia", "rise")]
        return np.array([(self.strength, self.inertia, self.rise)], np.dtype(fields))


@pytest.fixture
def syrup():
    """The law and a medium for it, registered while a test runs."""
    medium = Medium(
        name="test_treacle",
        title="invented",
        density=Quantity(1400.0, "kg/m^3", "chosen, not measured"),
        default_law="test_syrup",
        constants={
            "test_syrup": {"strength": Quantity(5e4, "N/m^3", "chosen, not measured")},
        },
    )
    mg.register_law(SyrupLaw)
    mg.register_medium(medium)
    yield medium
    mg.laws._things.pop("test_syrup")
    mg.media._things.pop("test_treacle")


def sinking(sand, depth=0.2, speed=0.3):
    data = mujoco.MjData(sand.model)
    data.qpos[2], data.qvel[0] = -depth, speed
    return sand.report(data).bodies[0]


def test_a_law_and_a_medium_from_outside(syrup):
    assert mg.laws["test_syrup"] is SyrupLaw
    sand = Sand(body("type='box' size='.05 .04 .03'"), medium="test_treacle", scheme="explicit")
    assert sand.law == SyrupLaw(5e4)
    # One leading face, its middle 0.2 m deep.
    found = sinking(sand)
    assert found.force == pytest.approx([-5e4 * 0.2 * 0.08 * 0.06, 0, 0], rel=1e-12)
    assert found.validity  # inherited from resistive force theory


def test_a_law_from_outside_needs_no_registration():
    sand = Sand(body("type='box' size='.05 .04 .03'"), law=SyrupLaw(1e4), scheme="explicit")
    assert sinking(sand).force[0] == pytest.approx(-1e4 * 0.2 * 0.08 * 0.06, rel=1e-12)


def test_a_law_from_outside_has_the_options_of_the_loop(syrup):
    sand = Sand(
        body("type='box' size='.05 .04 .03'"), law=SyrupLaw(0.0, inertia=1000.0), scheme="explicit"
    )
    assert sinking(sand).force[0] == pytest.approx(-1000 * 0.3**2 * 0.08 * 0.06, rel=1e-12)


@pytest.mark.parametrize("surface", [mg.Plane(0.1, 0.2, 0.3), mg.Plane()])
def test_a_law_from_outside_steps(syrup, surface):
    sand = Sand(
        body("type='sphere' size='.05'"), medium="test_treacle", surface=surface, scheme="explicit"
    )
    data = mujoco.MjData(sand.model)
    data.qpos[2] = 0.2
    for _ in range(500):
        sand.step(data)
    assert np.isfinite(data.qpos).all()
    height = surface.normal @ data.qpos[:3] - surface.height * surface.normal[2]
    assert -0.1 < height < 0.05  # in the sand, and nearly at rest
    assert np.linalg.norm(data.qvel[:3]) < 0.2


def test_a_law_from_outside_cannot_take_a_name(syrup):
    with pytest.raises(InputError, match="'test_syrup' exists already"):
        mg.register_law(dataclasses.make_dataclass("Other", [], bases=(SyrupLaw,), frozen=True))
    with pytest.raises(InputError, match="'test_treacle' exists already"):
        mg.register_medium(dataclasses.replace(syrup, title="another"))
    mg.register_medium(dataclasses.replace(syrup, title="another"), replace=True)
    assert mg.media["test_treacle"].title == "another"


def test_an_unknown_law_of_a_medium(syrup):
    other = dataclasses.replace(syrup, default_law="test_molasses", constants={"test_molasses": {}})
    with pytest.raises(UnknownNameError, match=r"no law 'test_molasses'; there are: .*test_syrup"):
        Sand(body(), medium=other, scheme="explicit")
