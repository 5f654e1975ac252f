"""Media and MJCF configurations of strangers: accepted, or one clear error at once."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import strangers
from hypothesis import given
from hypothesis import strategies as st
from seeds import attacked
from strangers import CANARY

from mjgranular.errors import InputError
from mjgranular.medium.file import EXAMPLE

Draw = Callable[[st.SearchStrategy[Any]], Any]

VALUES = (
    "", "~", "null", "true", "no", "1e400", "-1e400", ".nan", ".inf", "-.Inf", "nan",
    "0x7fffffff", "010", "1_0", "1:2:3", "1:30.5", "9" * 400, "9" * 5000, "0x" + "f" * 3000, "-0",
    "2023-99-99", "2001-02-31T25:61:61Z", "0000-00-00", "[1500]", "[]", "{}", "{a: {b: c}}",
    "*nowhere", "*a", "&a 5", "&a [1, *a]", "<<", "? x", "- - - x", "!!float 3", "!!binary aGk=",
    "!!timestamp x", "!!set {a, b}", "!!omap [a: 1]", "!!python/none x",
    "!!python/name:os.system", "!!python/object/apply:os.system [touch " + CANARY + "]",
    "!!python/object/new:subprocess.Popen [[touch, " + CANARY + "]]", "! x", "!<tag:x> y",
    "|\n  a\n", ">-\n  a\n   b\n", "'", '"', '"\\x00"', '"\\e[31mred"', '"\\u202e"', '"\\ud800"',
    "[/bold]", "%s%n", "{value: {value: {value: 1}}}", "\t", "@", "`", "é" * 200, "x" * 1999,
    "x" * 3000, "\u2028", ":",
)  # fmt: skip
"""Replacements for a word of a medium."""

KINDS = ("pipe", "zero", "folder", "loop", "sparse", "missing", "long", "null", "unreadable")
"""Replacements for a file."""

NUMBERS = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "1e-320", "-0.0", "0", "-1", "1e20",
    "99999999", "2147483648", "-2147483649", "9223372036854775808", "9" * 500, "9" * 5000, "1_0",
    "0x10", "1.5", "٣", "", "1e", "true", "None", "1;2", "1e9", "1j",
)  # fmt: skip
"""Replacements for a number in MJCF."""

TEXTS = (
    "", " ", "  \t ", "all", "''", '""', "'", '"', "\\", "link", "link link", "link eta_d=",
    "link =7", "link eta_d=1 eta_d=2", "link eta_d==7", "link name=x", "link title=x",
    "link __class__=x", "link eta_d=__import__('os').system('touch " + CANARY + "')",
    "$(touch " + CANARY + ")", "`touch " + CANARY + "`", "; touch " + CANARY,
    "../../../etc/passwd", "/dev/zero", "stranger.yaml", "/dev/zero.yaml", "pipe.yaml",
    "folder.yaml", "evil.yaml", "x" * 5000 + ".yaml", "a\nb", "a\rb", "\x1b[31mred", "\u202eabc",
    "é" * 300, "名" * 300, "[/red]", "%s%n%n%n", "%", "{0.__class__}", "plane height=nan",
    "plane slope=1.6", "plane height=1e300", "plane", "bed", "bed geom=rod",
    "bed geom='no such tray'", "height_field geom=tray", "implicit evaluations=0",
    "implicit evaluations=1e3", "implicit evaluations=99999999999999999999",
    "explicit half_step=maybe", "rod second rod", "world", "tray", "-1", "6", "0 0 0 0", "forces",
    "depth depth depth", "colors", "true", "TRUE", "false", "1", "a " * 30_000, "x" * 90_000,
    "x" * 300_000, "'" * 99_999,
)  # fmt: skip
"""Replacements for the string of a key."""

NAMES = (
    "", " ", "sand", "sand 2", "%s%n", "[/red]", "\x1b[31m", "\u202e", "é" * 300, "x" * 5000, "'",
    '"', "all", "world", "1", "a/b", "a\nb", "-", "名",
)  # fmt: skip
"""Names of instances, bodies and geoms."""

SOUND = {
    "medium": "play_sand",
    "law": "link eta_d=7 exponent=1.2",
    "surface": "plane height=0.01 slope=0.02",
    "scheme": "explicit",
    "bodies": "rod 'second rod'",
    "geoms": "rod",
    "groups": "0",
    "resolution": "4",
    "tunable": "true",
}
UNKNOWN = ("median", "Medium", "law ", "__class__", "", "x" * 300, "é", "plugin", "draws", "state")
OTHERS = (
    "",
    "<instance name='second'/>",
    "<instance name='sand'/>",
    "<instance name='second'><config key='bodies' value='rod'/></instance>",
    "<config key='medium' value='play_sand'/>",
    "".join(f"<instance name='s{number}'/>" for number in range(30)),
)
OBJECTS = (
    "", "objtype='body' objname='rod'", "objtype='body' objname='nowhere'", "objtype='body'",
    "objtype='geom' objname='tray'", "objtype='xbody' objname='rod'", "objtype='x' objname='y'",
    "objtype='body' objname='world'", "objtype='plugin' objname='sand'", "objname='rod'",
    "objtype='body' objname='rod' reftype='body' refname='rod'", "cutoff='nan'", "user='1'",
)  # fmt: skip


# Media


@st.composite
def damaged_media(draw: Draw) -> bytes:
    """Replace words and values of the example, and damage lines and bytes."""
    text = EXAMPLE + "grain: {value: 0.0003, unit: m, source: sieved}\n"
    changes = (_word, _word, _value, _value, _line, _letter)
    for change in draw(st.lists(st.sampled_from(changes), min_size=1, max_size=4)):
        text = change(draw, text)
    codec = draw(st.sampled_from(("utf-8",) * 9 + ("utf-16", "utf-32", "utf-8-sig")))
    content = text.encode(codec, "surrogatepass")
    for at in draw(st.lists(st.integers(0, len(content) - 1), max_size=2)):
        content = content[:at] + draw(st.binary(max_size=3)) + content[at + 1 :]
    return content


def _replaced(draw: Draw, text: str, pattern: str) -> str:
    """Replace what a pattern finds in one place."""
    places = [match.span() for match in re.finditer(pattern, text)] or [(0, 0)]
    start, end = draw(st.sampled_from(places))
    return text[:start] + draw(st.sampled_from(VALUES)) + text[end:]


def _word(draw: Draw, text: str) -> str:
    return _replaced(draw, text, r"[^\s:{},]+")


def _value(draw: Draw, text: str) -> str:
    return _replaced(draw, text, r"(?<=: )[^,}\n]+")


def _line(draw: Draw, text: str) -> str:
    """Replace, copy, indent or add a line."""
    lines = text.split("\n")
    at = draw(st.integers(0, len(lines) - 1))
    strange = ("---", "...", "%YAML 9.9", "- x", "? y", "# z", "a: &b {c: d}")
    put = draw(st.sampled_from((*strange, *lines, " " * 3 + lines[at])))
    lines[at : at + draw(st.integers(0, 1))] = [put]
    return "\n".join(lines)


def _letter(draw: Draw, text: str) -> str:
    """Replace or insert a character."""
    at = draw(st.integers(0, len(text)))
    put = draw(st.sampled_from(("", *"{}[]&*!%'\":-\x1b")))
    return text[:at] + put + text[at + draw(st.integers(0, 1)) :]


def bombs(size: int, width: int) -> Iterator[str]:
    """Write media that grow when they are read."""
    levels = min(size // (5 * width), 60)
    for open_, close, first in (("[", "]", "[x]"), ("{<<: [", "]}", "{x: 1}")):
        many = [
            f"a{k}: &a{k} {open_}{','.join([f'*a{k - 1}'] * width)}{close}"
            for k in range(1, levels)
        ]
        yield "\n".join([f"a0: &a0 {first}", *many, EXAMPLE])
    yield (
        EXAMPLE.replace("1500", "&b " + "1" * min(size, 50_000)) + f"grain: [{'*b,' * (size // 4)}]"
    )
    yield from (start * (size // len(start)) for start in ("[", "{a: ", "- ", "? ", "\n", "\x00"))
    yield "[" + "[]," * (size // 3) + "]"
    yield "{" + ",".join(f"k{k}" for k in range(size // 7)) + "}"
    yield "\n".join(f"k{k}: {{}}" for k in range(size // 10))
    for word, long in (
        ("my_sand", "x" * size),
        ("1500", "9" * size),
        ("1500", "1:" * (size // 2) + "1"),
    ):
        yield EXAMPLE.replace(word, long)
    yield EXAMPLE.replace("my_sand", '"' + "\\x41" * (size // 4) + '"')
    yield EXAMPLE + "".join(f"    k{k}: {{value: 1, source: x}}\n" for k in range(size // 32))
    yield "&" + "a" * size + " x"
    yield "%TAG ! " + "a" * size + "\n---\nx"
    yield "|\n" + " a\n" * (size // 3)


# MJCF


@st.composite
def hostile_models(draw: Draw) -> bytes:
    """Write a model with a configuration that is damaged in up to three places."""
    keys = draw(st.lists(st.sampled_from(sorted(SOUND)), unique=True))
    model = {"sand": [(key, SOUND[key]) for key in keys]}
    changes = (*[_number] * 4, *[_text] * 6, _key, _sensor, _sensor, _name, _name, _instances)
    for change in draw(st.lists(st.sampled_from(changes), min_size=1, max_size=3)):
        change(draw, model)
    content = xml_of(**model).encode("utf-8", "surrogatepass")
    for _ in range(draw(st.sampled_from((0,) * 9 + (1, 3)))):  # mostly within strings
        at = draw(
            st.sampled_from([m.start() for m in re.finditer(rb'(?<=[="a-z])[a-z_]', content)])
        )
        content = content[:at] + draw(st.binary(min_size=1, max_size=1)) + content[at + 1 :]
    return content


def _number(draw: Draw, model: dict[str, Any]) -> None:
    """Replace a number."""
    sand, number = model["sand"], draw(st.sampled_from(NUMBERS))
    places = [
        (row, match.span())
        for row, (_, text) in enumerate(sand)
        for match in re.finditer(r"[\d.]+", text)
    ]
    if not places:
        sand.append(("law", f"link eta_v={number}"))
        return
    row, (start, end) = draw(st.sampled_from(places))
    key, text = sand[row]
    sand[row] = (key, text[:start] + number + text[end:])


def _text(draw: Draw, model: dict[str, Any]) -> None:
    """Replace the string of a key."""
    key = draw(st.sampled_from(sorted([*SOUND, "draw"])))
    text = draw(st.sampled_from(TEXTS) | st.integers(1, 10**6).map("x".__mul__))
    model["sand"] = [pair for pair in model["sand"] if pair[0] != key] + [(key, text)]


def _key(draw: Draw, model: dict[str, Any]) -> None:
    """Add a key that does not exist, or one twice."""
    unknown = st.tuples(st.sampled_from(UNKNOWN), st.sampled_from(TEXTS))
    twice = st.sampled_from(model["sand"]) if model["sand"] else unknown
    model["sand"].append(draw(twice | unknown))


def _sensor(draw: Draw, model: dict[str, Any]) -> None:
    """Replace the sensor; it may have nothing to measure."""
    texts = ("force", "moment", "depth", "power", "speed", "Force", "sand", *TEXTS, *NAMES)
    keys = st.sampled_from(("measure",) * 5 + ("sand",) * 4 + UNKNOWN)
    model["sensor"] = draw(st.lists(st.tuples(keys, st.sampled_from(texts)), max_size=2))
    model["measured"] = draw(st.sampled_from(OBJECTS))


def _name(draw: Draw, model: dict[str, Any]) -> None:
    """Use an unusual name."""
    model[draw(st.sampled_from(("first", "second", "name")))] = draw(st.sampled_from(NAMES))


def _instances(draw: Draw, model: dict[str, Any]) -> None:
    """Add instances, or remove the name of the only one."""
    model["others"] = "".join(draw(st.lists(st.sampled_from(OTHERS), max_size=2)))
    model["name"] = draw(st.sampled_from(("sand", "sand", None)))


def xml_of(
    sand: list[tuple[str, str]],
    name: str | None = "sand",
    first: str = "rod",
    second: str = "second rod",
    others: str = "",
    sensor: list[tuple[str, str]] | None = None,
    measured: str = "",
) -> str:
    """Write a model with this configuration."""
    named = f"name={_quoted(name)}" if name is not None else ""
    sensor = [("measure", "force"), ("sand", "sand")] if sensor is None else sensor
    return f"""<mujoco model="attack">
  <option timestep="1e-5"/>
  <size memory="1M"/>
  <extension>
    <plugin plugin="mjgranular.sand"><instance {named}>{_configs(sand)}</instance>{others}</plugin>
    <plugin plugin="mjgranular.sensor"/>
  </extension>
  <worldbody>
    <geom name="tray" type="box" pos="0 0 -.2" size=".5 .5 .2"/>
    <body name={_quoted(first)} pos="0 0 .05">
      <freejoint/><geom name={_quoted(first)} type="capsule" size=".01 .1"/>
    </body>
    <body name={_quoted(second)} pos=".3 0 .05">
      <freejoint/><geom type="capsule" size=".02 .1"/>
    </body>
  </worldbody>
  <sensor>
    <plugin name="drag" plugin="mjgranular.sensor" {measured}>{_configs(sensor)}</plugin>
  </sensor>
</mujoco>"""


def _configs(pairs: list[tuple[str, str]]) -> str:
    return "".join(f"<config key={_quoted(key)} value={_quoted(text)}/>" for key, text in pairs)


def _quoted(text: str) -> str:
    """Quote an XML attribute; MuJoCo's reader accepts control characters by their numbers."""
    special = {c: f"&#{ord(c)};" for c in "\"&<>'\n\r\t\x1b"}
    return '"' + "".join(special.get(c, c) for c in text) + '"'


# Tests


@pytest.fixture(scope="module")
def child(child_with: Callable[..., Any]) -> Any:
    models = [xml_of([*SOUND.items(), ("draw", "forces depth")]), xml_of([])]
    return child_with(functools.partial(strangers.prepare_text, EXAMPLE, models))


@pytest.mark.slow
@attacked(80)
@given(content=damaged_media())
def test_damaged_media(child: Any, content: bytes) -> None:
    assert not child(strangers.read, strangers.read_medium, content)


@pytest.mark.slow
@attacked(40)
@given(data=st.data())
def test_media_that_grow(child: Any, data: st.DataObject) -> None:
    size = data.draw(st.sampled_from((100, 2000, 20_000, 99_000, 150_000, 2_000_000)))
    bomb = data.draw(st.sampled_from([*bombs(size, data.draw(st.integers(2, 11)))]))
    assert not child(strangers.read, strangers.read_medium, bomb.encode())


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_files_that_are_not_media(child: Any, kind: str) -> None:
    assert not child(strangers.read, strangers.read_medium, kind)


@pytest.mark.slow
@attacked(120)
@given(content=hostile_models())
def test_hostile_configurations(child: Any, content: bytes) -> None:
    assert not child(strangers.read, strangers.read_model, content)


@pytest.mark.parametrize(
    ("error", "wrong"),
    [
        (KeyError("x"), "not an error of the package"),
        (ValueError("XML Error"), "not an error of the package"),
        (InputError("x" * 1900), ""),
    ],
)
def test_errors_that_are_not_clear_are_found(error: Exception, wrong: str) -> None:
    found = strangers.complaints_of(error, by_mujoco=False)
    assert [text.partition(":")[0] for text in found] == [wrong] * bool(wrong)


@pytest.mark.slow
def test_executions_are_found(child: Any) -> None:
    content = f"import os; os.system('touch {CANARY}')"
    assert "executed os.system" in child(strangers.read, exec, content)
