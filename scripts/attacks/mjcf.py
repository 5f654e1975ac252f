"""Load models with hostile plugin configurations."""

from __future__ import annotations

import json
import math
import re
from argparse import Namespace
from pathlib import Path
from random import Random

import mujoco
import numpy as np
from attacks import untrusted
from attacks.untrusted import CANARY
from attacks.worker import Case, Note, Result

from mjgranular.cli import main
from mjgranular.medium.file import EXAMPLE

NUMBERS = (
    "nan", "inf", "-inf", "1e400", "-1e400", "1e308", "1e-320", "-0.0", "0", "-1", "1e20",
    "99999999", "2147483648", "-2147483649", "9223372036854775808", "9" * 500, "9" * 5000, "1_0",
    "0x10", "1.5", "٣", "", "1e", "true", "None", "1;2", "1e9", "1j",
)  # fmt: skip
"""Replacements for a number."""

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
    "depth depth depth", "colours", "true", "TRUE", "false", "1", "a " * 30_000, "x" * 90_000,
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
SOUND_SENSOR = {"measure": "force", "sand": "sand"}
UNKNOWN = ("median", "Medium", "law ", "__class__", "", "x" * 300, "é", "plugin", "draws", "state")


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List cases; each depends on those before it."""
    random = Random(options.seed)
    return [make_case(random) for _ in range(numbers.stop)][numbers.start :]


def make_case(random: Random) -> Case:
    """Draw a case: the bytes of a model, each as a character."""
    keys = random.sample(sorted(SOUND), random.randrange(len(SOUND) + 1))
    case: Case = {
        "sand": [(key, SOUND[key]) for key in keys],
        "name": "sand",
        "bodies": ["rod", "second rod"],
        "others": [],
        "sensor": list(SOUND_SENSOR.items()),
        "object": random.choice(("", "objtype='body' objname='rod'")),
    }
    changes = (*[_number] * 4, *[_text] * 6, _key, _sensor, _sensor, _name, _name, _instances)
    for _ in range(random.choice((1, 1, 2, 3))):
        random.choice(changes)(case, random)
    content = _xml(case).encode("utf-8", "surrogatepass")
    for _ in range(random.choice((*[0] * 12, 1, 3))):  # mostly within strings
        letters = re.finditer(rb'(?<=[="a-z])[a-z_]', content)
        at = random.choice([found.start() for found in letters])
        content = content[:at] + random.randbytes(1) + content[at + 1 :]
    return {"content": content.decode("latin-1")}


def prepare() -> None:
    """Compile what valid cases need, and check that they are accepted."""
    Path("stranger.yaml").write_text(EXAMPLE, encoding="utf-8")
    Path("evil.yaml").write_text(f"!!python/object/apply:os.system [touch {CANARY}]", "utf-8")
    untrusted.put_special(Path("pipe.yaml"), "pipe")
    untrusted.put_special(Path("folder.yaml"), "folder")
    sound = {
        "name": "sand", "bodies": ["rod", "second rod"], "others": [],
        "sensor": list(SOUND_SENSOR.items()), "object": "",
    }  # fmt: skip
    for sand in ({**SOUND, "draw": "forces depth"}, {}):
        read({"content": _xml({**sound, "sand": list(sand.items())})})
    untrusted.guard()


def attempt(case: Case, _note: Note) -> Result:
    """Read a case."""
    return untrusted.read(lambda: read(case), json.dumps(case), own_words)


def read(case: Case) -> str:
    """Load the model, take some steps, and list its elements with the command."""
    path = Path("model.xml")
    path.write_bytes(case["content"].encode("latin-1"))
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except Exception:
        assert main(["elements", str(path)]) == 2
        raise
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 3)
    assert np.isfinite(data.qpos).all() or any(warning.number for warning in data.warning)
    code = main(["elements", str(path), "--medium", "play_sand"])
    assert code in (0, 2)
    return f"{model.nplugin} plugins, elements {code}"


def own_words(error: Exception) -> str | None:
    """Return our message in a MuJoCo error, or MuJoCo's own; None for any other error."""
    if isinstance(error, UnicodeDecodeError):  # MuJoCo repeats its input
        return None if b"mjgranular '" in error.object else "MuJoCo: not UTF-8"
    said = str(error)
    ours = re.search(r"mjgranular (?:'.*?'|\".*?\"): (.*)", said, re.DOTALL)
    if ours is None:
        return f"MuJoCo: {' '.join(said.split())!r}"[:300]
    leak = re.match(r"\w*(Error|Exception|Interrupt)\(", ours[1])
    return None if leak else ours[1]


def _xml(case: Case) -> str:
    first, second = case["bodies"]
    sand = _configs(case["sand"])
    named = f"name={_quoted(case['name'])}" if case["name"] is not None else ""
    return f"""<mujoco model="attack">
  <option timestep="1e-5"/>
  <size memory="1M"/>
  <extension>
    <plugin plugin="mjgranular.sand">
      <instance {named}>{sand}</instance>
      {"".join(case["others"])}
    </plugin>
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
    <plugin name="drag" plugin="mjgranular.sensor" {case["object"]}>
      {_configs(case["sensor"])}
    </plugin>
  </sensor>
</mujoco>"""


def _configs(pairs: list[tuple[str, str]]) -> str:
    return "".join(f"<config key={_quoted(key)} value={_quoted(text)}/>" for key, text in pairs)


def _quoted(text: str) -> str:
    """Quote an XML attribute; MuJoCo's reader accepts control characters by their numbers."""
    special = {c: f"&#{ord(c)};" for c in "\"&<>'\n\r\t\x1b"}
    return '"' + "".join(special.get(c, c) for c in text) + '"'


def _number(case: Case, random: Random) -> None:
    """Replace a number."""
    places = [
        (i, m) for i, (_, text) in enumerate(case["sand"]) for m in re.finditer(r"[\d.]+", text)
    ]
    if not places:
        case["sand"].append(("law", f"link eta_v={random.choice(NUMBERS)}"))
        return
    at, found = random.choice(places)
    key, text = case["sand"][at]
    case["sand"][at] = (key, text[: found.start()] + random.choice(NUMBERS) + text[found.end() :])


def _text(case: Case, random: Random) -> None:
    """Replace the string of a key."""
    key = random.choice(sorted([*SOUND, "draw"]))
    case["sand"] = [pair for pair in case["sand"] if pair[0] != key]
    case["sand"].append((key, random.choice(TEXTS)))


def _key(case: Case, random: Random) -> None:
    """Add a key that does not exist, or one twice."""
    if case["sand"] and random.random() < 0.5:
        case["sand"].append(random.choice(case["sand"]))
    else:
        case["sand"].append((random.choice(UNKNOWN), random.choice(TEXTS)))


def _sensor(case: Case, random: Random) -> None:
    """Replace the sensor; it may have nothing to measure."""
    texts = ("force", "moment", "depth", "power", "speed", "Force", "sand", *TEXTS, *NAMES)
    keys = random.choices(
        ("measure", "sand", *UNKNOWN), (30, 20, *([1] * len(UNKNOWN))), k=random.randrange(3)
    )
    case["sensor"] = [(key, random.choice(texts)) for key in keys]
    case["object"] = random.choice(
        (
            "", "objtype='body' objname='rod'", "objtype='body' objname='nowhere'",
            "objtype='body'", "objtype='geom' objname='tray'", "objtype='xbody' objname='rod'",
            "objtype='x' objname='y'", "objtype='body' objname='world'",
            "objtype='plugin' objname='sand'", "objname='rod'",
            "objtype='body' objname='rod' reftype='body' refname='rod'", "cutoff='nan'",
            "user='1'",
        )
    )  # fmt: skip


def _name(case: Case, random: Random) -> None:
    """Use an unusual name."""
    if random.random() < 0.5:
        case["bodies"][random.randrange(2)] = random.choice(NAMES)
    else:
        case["name"] = random.choice(NAMES)


def _instances(case: Case, random: Random) -> None:
    """Add instances, or remove the name of the only one."""
    others = [
        "",
        "<instance name='second'/>",
        "<instance name='sand'/>",
        "<instance name='second'><config key='bodies' value='rod'/></instance>",
        "<config key='medium' value='play_sand'/>",
        "".join(f"<instance name='s{i}'/>" for i in range(random.choice((2, 30)))),
    ]
    case["others"] = random.sample(others, random.randrange(1, 3))
    if random.random() < 0.1:
        case["name"] = None
    if random.random() < 0.2:
        case["sand"] = [("medium", "x" * math.floor(10 ** random.uniform(1, 6)))]
