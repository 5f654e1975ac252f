"""Errors: their classes, and that each says what would be right."""

import dataclasses
import math
import pickle
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

import mjgranular as mg
from mjgranular.errors import (
    GranularError,
    InputError,
    MissingExtraError,
    OutputError,
    RenderError,
    UnknownArgumentError,
    UnknownNameError,
    UnstableError,
)
from mjgranular.kernel import compiled
from mjgranular.kernel.compiled import KernelError
from mjgranular.kernel.engine import LayoutError
from mjgranular.kernel.vector import Vector, diagonal
from mjgranular.models import Link, model_path


def quantity(value):
    return mg.Quantity(value, "", "chosen, not measured")


def medium(name="drawn", density=1500.0, default_law="link", constants=None):
    if constants is None:
        constants = {"eta_d": 1.0, "eta_h": 1.0, "eta_v": 1.0, "exponent": 1.0}
    return mg.Medium(
        name=name,
        title="for a test",
        density=mg.Quantity(density, "kg/m^3", "chosen, not measured"),
        default_law=default_law,
        constants={"link": {key: quantity(value) for key, value in constants.items()}},
    )


def sand_on(xml, **options):
    return mg.Sand(mujoco.MjModel.from_xml_string(f"<mujoco>{xml}</mujoco>"), **options)


BALL = "<body><freejoint/><geom name='ball' type='sphere' size='.1'/></body>"
ROD = "<body name='rod'><freejoint/><geom type='capsule' size='.01 .1'/></body>"
POST = "<body name='post'><geom name='post' type='capsule' size='.01 .1'/></body>"
GHOST = (
    "<body><freejoint/>"
    "<geom name='ghost' type='capsule' size='.01 .1' contype='0' conaffinity='0'/></body>"
)


def world(*bodies):
    return f"<worldbody>{''.join(bodies)}</worldbody>"


# Names


@pytest.mark.parametrize(
    ("option", "kind", "known"),
    [
        ({"medium": "moon"}, "medium", ["play_sand"]),
        ({"law": "stokes"}, "law", ["link", "link_distributed"]),
        ({"scheme": "magic"}, "scheme", ["explicit"]),
        ({"bodies": "hnad"}, "body", ["trunk", "arm", "hand", "probe"]),
        ({"bodies": ["arm", "hnad"]}, "body", ["trunk", "arm", "hand", "probe"]),
        ({"geoms": "hnad"}, "geom", ["trunk", "arm", "spike", "hand", "fin", "floor"]),
    ],
)
def test_unknown_names_are_told_the_known(chain_model, option, kind, known):
    with pytest.raises(UnknownNameError) as caught:
        mg.Sand(chain_model, **option)
    error, message = caught.value, str(caught.value)
    assert kind in error.kind
    assert "hnad" in message or str(*option.values()) in message
    for name in known:
        assert name in error.known
        assert name in message
    assert not message.startswith(("'", '"'))


def test_unknown_names_are_key_errors():
    with pytest.raises(KeyError):
        mg.media["moon"]
    with pytest.raises(KeyError):
        mg.laws["stokes"]
    with pytest.raises(KeyError):
        mg.schemes["magic"]


def test_constants_for_a_law_that_a_medium_has_none_for():
    with pytest.raises(UnknownNameError, match=r"play_sand.*nonesuch.*link"):
        mg.media["play_sand"].constants_for("nonesuch")


def test_report_of_a_body_without_sand(chain_model):
    sand = mg.Sand(chain_model, bodies="arm")
    with pytest.raises(UnknownNameError, match=r"'hand'.*arm"):
        sand.report(mujoco.MjData(chain_model))["hand"]


def test_unknown_model():
    with pytest.raises(UnknownNameError, match=r"'lnik'.*link"):
        model_path("lnik")


# Models


def test_a_geom_that_is_no_rod():
    with pytest.raises(InputError, match=r"'ball' is a sphere.*capsules and cylinders"):
        sand_on(world(BALL), medium="play_sand")


def test_a_geom_without_a_name_is_told_by_its_number():
    with pytest.raises(InputError, match=r"number 0.*sphere"):
        sand_on(world(BALL.replace("name='ball' ", "")), medium="play_sand")


@pytest.mark.parametrize("option", [{"bodies": "post"}, {"geoms": "post"}, {"bodies": "world"}])
def test_a_body_that_cannot_move(option):
    with pytest.raises(InputError, match=r"fixed to the world.*joint"):
        sand_on(world(ROD, POST), **option)


def test_a_geom_of_the_world():
    floor = "<geom name='floor' type='plane' size='1 1 1'/>"
    with pytest.raises(InputError, match="fixed to the world"):
        sand_on(world(floor, ROD), geoms="floor")


@pytest.mark.parametrize("bodies", [(), (POST,), (GHOST,)])
def test_nothing_that_meets_the_sand(bodies):
    with pytest.raises(InputError, match=r"no geom.*contype.*geoms="):
        sand_on(world(*bodies))


def test_a_ghost_can_be_named():
    assert len(sand_on(world(GHOST), law="link", geoms="ghost").elements) == 1


def test_no_names_at_all_are_nothing():
    for option in ({"bodies": []}, {"geoms": ()}):
        with pytest.raises(InputError, match="no geom"):
            sand_on(world(ROD), **option)


def test_runge_kutta():
    with pytest.raises(InputError, match=r"RK4.*Euler, implicit or implicitfast"):
        sand_on("<option integrator='RK4'/>" + world(ROD))


def test_runge_kutta_chosen_afterwards():
    sand = sand_on(world(ROD))
    sand.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(InputError, match="RK4"):
        sand.step(mujoco.MjData(sand.model))


def test_runge_kutta_chosen_under_way():
    sand = sand_on(world(ROD))
    data = mujoco.MjData(sand.model)
    sand.step(data)
    sand.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(InputError, match="RK4"):
        sand.step(data)


def test_data_of_another_model(link_model, chain_model):
    sand = mg.Sand(link_model)
    same = Link().model(1e-5)
    for other in (chain_model, same):
        data = mujoco.MjData(other)
        for call in (sand.step, sand.apply):
            with pytest.raises(InputError, match=r"another model.*MjData\(model\)"):
                call(data)
        assert data.time == 0


def test_report_on_data_of_another_model(link_model):
    # Of the same size, so that nothing else would complain.
    shorter = mujoco.MjData(Link(length=0.1).model(1e-5))
    with pytest.raises(InputError, match="another model"):
        mg.Sand(link_model).report(shorter)


# Values


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["height", "slope", "uphill"])
def test_plane_must_be_finite(name, bad):
    with pytest.raises(InputError, match=rf"{name} must be finite"):
        mg.Plane(**{name: bad})


@pytest.mark.parametrize("slope", [math.pi / 2, -math.pi / 2, 2.0, 45.0])
def test_plane_must_not_stand_upright(slope):
    with pytest.raises(InputError, match=r"less than 90 degrees.*1\.5708 rad"):
        mg.Plane(slope=slope)


@pytest.mark.parametrize("density", [0.0, -1.0, math.nan, math.inf])
def test_density_must_be_positive(density):
    with pytest.raises(InputError, match=r"'drawn'.*density must be .*kg/m"):
        medium(density=density)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_constants_must_be_finite(bad):
    with pytest.raises(InputError, match=r"'drawn'.*link\.eta_d must be finite"):
        medium(constants={"eta_d": bad})


def test_default_law_must_have_constants():
    with pytest.raises(InputError, match=r"default law 'link_distributed'.*it has those of: link"):
        medium(default_law="link_distributed")


@pytest.mark.parametrize("law", [mg.LinkLaw, mg.DistributedLinkLaw])
@pytest.mark.parametrize("key", ["eta_d", "eta_h", "eta_v", "exponent"])
@pytest.mark.parametrize("bad", [-1e-9, math.nan, math.inf])
def test_coefficients_must_not_be_negative(law, key, bad):
    coefficients = {"eta_d": 1, "eta_h": 1, "eta_v": 1, "exponent": 1, key: bad}
    with pytest.raises(InputError, match=rf"{law.__name__}: {key} must be finite and not negative"):
        law(**coefficients)


@pytest.mark.parametrize("pieces", [0, -3])
def test_a_rod_has_at_least_one_piece(pieces):
    with pytest.raises(InputError, match="at least 1"):
        mg.DistributedLinkLaw(1, 1, 1, 1, pieces=pieces)


@pytest.mark.parametrize("name", ["length", "diameter", "density"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_link_has_sizes(name, bad):
    with pytest.raises(InputError, match=rf"{name} must be positive and finite"):
        Link(**{name: bad})


@pytest.mark.parametrize("diameter", [0.2, 0.3])
def test_link_is_slender(diameter):
    with pytest.raises(InputError, match="longer than it is thick"):
        Link(length=0.2, diameter=diameter)


# Registers


def test_a_name_is_given_once(register):
    mine = medium(name="test_once")
    assert register(mine) is mine
    assert register(mine) is mine  # the same again is no clash
    with pytest.raises(InputError, match=r"'test_once' exists already.*replace=True"):
        register(medium(name="test_once"))
    assert mg.media["test_once"] is mine
    other = register(medium(name="test_once"), replace=True)
    assert mg.media["test_once"] is other
    assert "test_once" in mg.media


def test_a_law_without_a_name_cannot_be_registered():
    with pytest.raises(InputError, match="the law Law must have a class variable `name`"):
        mg.register_law(mg.Law)


class WrongCenter(NamedTuple):
    center: float


class Middle(NamedTuple):
    middle: Vector


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"parameters": lambda self, medium: [1.0]}, r"^Odd.parameters .* \(1,\), got a list$"),
        ({"parameters": lambda self, medium: np.zeros(2)}, r"^Odd.parameters .*, got a ndarray$"),
        (
            {"elements": lambda self, *_: None},
            r"^Odd.elements .* geom, body, slot, width, got None",
        ),
        ({"elements": lambda self, *_: np.zeros(2, [("geom", int)])}, r"got \(2,\), fields geom$"),
        ({"kernel": lambda self, surface: None}, r"^Odd.kernel must return a LawKernel, not None"),
        ({"respond": len}, r"^LawKernel: respond must be compiled.*, got len$"),
        ({"element": WrongCenter}, "a field 'center' of 1 numbers, as WrongCenter has, got 3"),
        ({"element": Middle}, "a field 'middle' of 3 numbers, as Middle has, got 0"),
    ],
)
def test_a_custom_law_is_checked(changed, said):
    def kernel(self, surface):
        good = mg.DepthVelocityLaw.kernel(self, surface)
        return dataclasses.replace(good, **changed)

    methods = {name: changed[name] for name in changed if hasattr(mg.Law, name)}
    odd = type("Odd", (mg.DepthVelocityLaw,), methods or {"kernel": kernel})(1.0, 200.0)
    with pytest.raises(InputError, match=said):
        sand_on(world(BALL), law=odd)


@compiled
def reversed_derivative(blob, law, g, v, p, eps):
    return -blob.limit * p, diagonal(blob.limit), -1.0 * v, diagonal(-1.0)


@compiled
def reversed_resistance(blob, law, g, v, p, eps):
    return blob.limit * p, diagonal(blob.limit), -1.0 * v, diagonal(-1.0)


@compiled
def reversed_drag(blob, law, g, v, p, eps):
    return -blob.limit * p, diagonal(-blob.limit), v, diagonal(1.0)


@compiled
def infinite_drag(blob, law, g, v, p, eps):
    return -blob.limit * p, diagonal(-blob.limit), (-1.0 / g / 0.0) * v, diagonal(0.0)


@pytest.mark.parametrize(
    ("respond", "said"),
    [
        (reversed_derivative, r"a derivative by p that, times p, .* a relative error of 2$"),
        (reversed_resistance, "a static resistance that opposes the motion, got the reverse$"),
        (reversed_drag, "a drag that opposes the motion, got the reverse$"),
        (infinite_drag, "finite forces, got -inf N$"),
    ],
)
def test_the_forces_of_a_custom_law_are_checked(respond, said):
    def kernel(self, surface):
        return dataclasses.replace(mg.DepthVelocityLaw.kernel(self, surface), respond=respond)

    odd = type("Odd", (mg.DepthVelocityLaw,), {"kernel": kernel})(1.0, 200.0)
    with pytest.raises(InputError, match=f"^Odd: respond must return {said}"):
        sand_on(world(BALL), law=odd)


def test_of_names_that_resemble_none_it_is_said_how_to_add_one():
    with pytest.raises(UnknownNameError, match=r"\(import its module, or name a .yaml file\)$"):
        mg.media["beach"]
    with pytest.raises(UnknownNameError, match=r"did you mean rft3d\?$"):
        mg.laws["rtf3d"]


def test_a_law_cannot_take_anothers_name():
    class Impostor(mg.LinkLaw):
        pass

    with pytest.raises(InputError, match="'link' exists already"):
        mg.register_law(Impostor)
    assert mg.laws["link"] is mg.LinkLaw


def test_a_registered_medium_can_be_used_by_name(link_model, register):
    mine = register(medium(name="test_by_name"))
    assert mg.Sand(link_model, medium="test_by_name").medium is mine


def test_every_constant_has_a_source():
    for one in mg.media.values():
        quantities = [one.density, *(q for c in one.constants.values() for q in c.values())]
        for value in quantities:
            assert len(value.source) > 5


def test_every_law_says_what_it_is_and_where_from():
    for name, law in mg.laws.items():
        assert law.name == name
        assert law.title
        assert law.citation


@pytest.mark.parametrize("field", ["medium", "law", "surface", "scheme"])
def test_sand_within_a_step_raises_the_same_class_for_an_unknown_name(field):
    with pytest.raises(UnknownNameError, match=rf"no {field} 'wet'; there are: "):
        mg.add_sand(mujoco.MjSpec(), **{field: "wet"})


# The classes


@pytest.mark.parametrize(
    ("error", "builtin"),
    [
        (InputError("a"), ValueError),
        (UnknownNameError("law", "b", ["link", "other"]), KeyError),
        (UnknownArgumentError("a sand", "medum", ["medium", "law"]), TypeError),
        (UnstableError("c"), ArithmeticError),
        (OutputError("d"), OSError),
        (RenderError("e"), RuntimeError),
        (MissingExtraError("matplotlib", "figures", "a figure"), ImportError),
        (LayoutError.of("mjpPlugin"), RuntimeError),
        (KernelError.of(KeyError("k"), "law mud"), TypeError),
    ],
)
class TestClasses:
    def test_root_and_builtin(self, error, builtin):
        assert isinstance(error, GranularError)
        assert isinstance(error, builtin)

    def test_pickles(self, error, builtin):
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is type(error)
        assert str(again) == str(error)
        assert vars(again) == vars(error)

    @pytest.mark.parametrize("message", [str, lambda error: error])  # Gymnasium gives the error
    def test_is_raised_again_from_its_message(self, error, builtin, message):
        again = type(error)(message(error))
        assert str(again) == str(error)
        assert str(pickle.loads(pickle.dumps(again))) == str(error)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("rtf3d", "no law 'rtf3d'; there are: link, rft2d, rft3d; did you mean rft3d?"),
        ("RFT3D", "no law 'RFT3D'; there are: link, rft2d, rft3d; did you mean rft3d?"),
        ("stokes", "no law 'stokes'; there are: link, rft2d, rft3d"),
        ("", "no law ''; there are: link, rft2d, rft3d"),
    ],
)
def test_a_misspelt_name_is_told_the_one_that_was_meant(given, said):
    assert str(UnknownNameError("law", given, ["link", "rft2d", "rft3d"])) == said


def test_of_many_names_those_that_may_be_meant_are_told():
    names = [f"{side}_{part}_{i}" for side in ("left", "right") for part in "abc" for i in range(9)]
    names += ["left_foot_sole"]
    meant = "did you mean left_foot_sole? There are 55 in all"
    assert str(UnknownNameError("geom", "left_fot_sole", names)) == (
        f"no geom 'left_fot_sole'; {meant}"
    )
    assert str(UnknownNameError("geom", "Foot", names)) == f"no geom 'Foot'; {meant}"


def test_missing_extra_says_what_to_install():
    error = MissingExtraError("matplotlib", "figures", "drawing")
    assert "drawing needs matplotlib" in str(error)
    assert "pip install 'mjgranular[figures]'" in str(error)
