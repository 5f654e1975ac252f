"""What strangers write, in files, models and names: one sentence each, at once, and no more."""

from __future__ import annotations

import os
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

import mjgranular as mg
from mjgranular import InputError, UnknownNameError
from mjgranular._util.io import read_file
from mjgranular.cli import main
from mjgranular.engine.config import LONGEST, read_config
from mjgranular.errors import listed, one_line, shown
from mjgranular.medium import read_medium
from mjgranular.medium.file import EXAMPLE, LARGEST

STRANGE = "[/red]\x1b[31m :smile: \u202e"


# Media


def refused(text: str, path: Path) -> str:
    """What is said of a file, which is to be soon."""
    path.write_text(text, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        read_medium(path)
    assert time.process_time() - began < 5
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 700
    return message


def laughs(open_: str, close: str) -> str:
    """Each level a number of times the one before."""
    levels = [f"a0: &a0 {open_}x{close}"]
    for level in range(1, 40):
        many = ", ".join([f"*a{level - 1}"] * 9)
        levels.append(f"a{level}: &a{level} {open_}{many}{close}")
    return "\n".join(levels)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (laughs("[", "]") + "\n" + EXAMPLE, "a medium has no key 'a0'"),
        (laughs("{<<: [", "]}") + "\n" + EXAMPLE, "a medium has no key 'a0'"),
        ("a: &a [*a]", "line 1: found unconstructable recursive node"),
        ("[" * 50_000, "nested too deeply"),
        ("{a: " * 20_000, "nested too deeply"),
        ("- " * 40_000, "nested too deeply"),
        ("? " * 40_000, "nested too deeply"),
        ("[" + "[]," * 33_000 + "]", "a mapping with name"),
        (EXAMPLE.replace("1500", "9" * 1900), "density.value must be a number"),
        (EXAMPLE.replace("1500", "9" * 5000), "density.value must be a number"),
        (EXAMPLE.replace("1500", "0x" + "f" * 1000), "must be a number"),
        (EXAMPLE.replace("1500", "1:" * 900 + "1"), "must be a number"),
        (
            EXAMPLE.replace("1500", "2023-99-99"),
            "must be a number, without its unit, got '2023-99-99'",
        ),
        (EXAMPLE.replace("my_sand", "2023-99-99") + "x: 2023-99-99", "no key 'x'"),
        (EXAMPLE.replace("my_sand", "[my_sand]"), "name must be a string, got ['my_sand']"),
        (EXAMPLE.replace("my_sand", "!!python/name:os.system"), "a medium needs name"),
        ('title: "\\UFFFFFFFF"\n', "unreadable"),
        (EXAMPLE + "[x]: y\n", "line 11: found unhashable key"),
        (EXAMPLE + "---\n" + EXAMPLE, "but found another document"),
        (EXAMPLE + "#" * LARGEST, "it is larger than 100 kB"),
        ("root:x:0:0:root:/root:/bin/sh\n" * 30, ""),
        ("secret\n" * 200, "a mapping with name"),
    ],
    ids=lambda text: text[:20],
)
def test_a_hostile_file_is_refused_at_once(tmp_path: Path, text: str, said: str) -> None:
    message = refused(text, tmp_path / "sand.yaml")
    assert said in message
    assert "secret" not in message


def test_nothing_in_a_file_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    refused("!!python/object/apply:os.system [touch executed]", tmp_path / "sand.yaml")
    assert not Path("executed").exists()


def test_an_alias_may_stand_for_a_text(tmp_path: Path) -> None:
    path = tmp_path / "sand.yaml"
    text = EXAMPLE.replace("source: guessed", "source: &who guessed", 1)
    path.write_text(text.replace("source: guessed", "source: *who"), encoding="utf-8")
    assert {q.source for q in read_medium(path).constants["link"].values()} == {"guessed"}


def test_texts_stay_as_they_are_written(tmp_path: Path) -> None:
    path = tmp_path / "sand.yaml"
    text = EXAMPLE.replace("my_sand", "007").replace("weighed", "2023-11-22")
    path.write_text(text.replace("Sand of the beach at home", "no"), encoding="utf-8")
    medium = read_medium(path)
    assert (medium.name, medium.title, medium.density.source) == ("007", "no", "2023-11-22")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
@pytest.mark.parametrize("kind", ["pipe", "device", "folder", "loop", "sparse", "long", "null"])
def test_only_regular_files_are_read(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "sand.yaml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "sparse":
        path.touch()
        os.truncate(path, 10**11)
    else:
        path = tmp_path / {"long": "x" * 5000, "null": "a\0b"}[kind]
    for read in (read_medium, lambda path: read_file(path, "the settings", largest=1000)):
        with pytest.raises(InputError, match="cannot read the") as caught:
            read(path)
        assert len(str(caught.value)) < 500


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in the file system")
@pytest.mark.parametrize("command", ["drop", "elements", "train"])
def test_commands_do_not_wait_for_a_pipe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    arguments = {"train": ["mjgranular/ChainSwim-v0", "--settings", str(path)]}
    assert main([command, *arguments.get(command, [str(path)])]) == 2
    assert "it is not a regular file" in capsys.readouterr().err


# Settings of a training

PPO = "algorithm = 'ppo'\n[ppo]\nnum_envs = 1\ntotal_steps = "


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 15_000, "is not TOML"),
        ("a = " + "9" * 5000, "is not TOML"),
        (".".join("a" * 9_990) + " = 1", "no key 'a'"),
        (".".join("a" * 50_000) + " = 1", "larger than 20 kB"),
        ("'" + "x" * 15_000 + "' = 1", "no key 'xxx"),
        (PPO + "0x" + "f" * 15_000, "a number of 60000 bits"),
        (PPO + "9\n[ppo.arguments]\nn_steps = 0x" + "f" * 15_000, "a number of 60000 bits"),
        (PPO + "9\n[ppo.arguments]\nn_steps = 1000000000000000003", "batch_size must divide"),
        (PPO + "9\nnet = " + "[" * 100 + "]" * 100, "a list of 1"),
        (PPO + "'" + "x" * 15_000 + "'", "'xxx"),
    ],
    ids=lambda text: text[:20],
)
def test_hostile_settings_are_refused_at_once(tmp_path: Path, text: str, said: str) -> None:
    pytest.importorskip("stable_baselines3")
    from mjgranular.learn.settings import find_settings

    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        find_settings("", file=path)
    assert time.process_time() - began < 5
    assert said in str(caught.value)
    assert len(str(caught.value)) < 900


# Configurations in MJCF


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("bodies", "x" * (LONGEST + 1), f"{LONGEST + 1} characters"),
        ("bodies", "'" + "x" * 9000, "cannot be split"),
        ("medium", "x" * 90_000, "no medium"),
        ("medium", "x" * 90_000 + ".yaml", "cannot read the medium"),
        ("law", "link eta_d=1 eta_d=2", "'eta_d' of the law 'link' is given twice"),
        ("law", "link eta_d=1e400", "not inf"),
        ("law", "link eta_d=nan", "not nan"),
        ("law", "link " + "x" * 9000 + "=1", "has no option"),
        ("law", "link_distributed pieces=1000000000", "pieces must be at most 100000"),
        ("resolution", "9" * 4000, "resolution must be at most 100000 in size, not a number of"),
        ("resolution", "9" * 9000, "must be an integer"),
        ("groups", "-99999999999999999999", "a group must be at most 100000 in size"),
        ("scheme", "implicit evaluations=1" + "0" * 30, "evaluations must be at most 100000"),
        ("tunable", "t" * 9000, "true or false"),
    ],
    ids=lambda text: text[:20],
)
def test_a_hostile_configuration_is_refused_shortly(key: str, text: str, said: str) -> None:
    kind = UnknownNameError if said == "no medium" else InputError
    with pytest.raises(kind, match=f"config {key!r}: ") as caught:
        read_config({key: text})
    assert said in str(caught.value)
    assert len(str(caught.value)) < 700


def test_names_that_are_not_utf8_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    body = "<body name='s\xe4nd'><freejoint/><geom type='capsule' size='.01 .1'/></body>"
    path.write_bytes(f"<mujoco><worldbody>{body}</worldbody></mujoco>".encode("latin-1"))
    model = mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(InputError, match="a name in the model is not UTF-8"):
        mg.Sand(model, medium="play_sand")


# Names in what is printed


def test_names_are_printed_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "model.xml"
    name = STRANGE.replace("\x1b", "&#27;")
    body = f"<body name='{name}'><freejoint/><geom type='capsule' size='.01 .1'/></body>"
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>", encoding="utf-8")
    assert main(["elements", str(path), "--medium", "play_sand"]) == 0
    printed = capsys.readouterr().out
    assert one_line(STRANGE) in printed
    assert "\x1b" not in printed


def test_a_medium_is_printed_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sand.yaml"
    path.write_text(EXAMPLE.replace("weighed", "'[/red] :smile:'"), encoding="utf-8")
    assert main(["list", "media", str(path)]) == 0
    assert "[/red] :smile:" in capsys.readouterr().out


@pytest.mark.parametrize("title", ["$\\frac$", "a$x^$", "_under", "a\x1b[31m", "$a$ $b"])
def test_names_in_figures_are_no_formulas(tmp_path: Path, title: str) -> None:
    pytest.importorskip("matplotlib")
    from mjgranular.picture.figures import draw_drop

    t, ones = np.linspace(0, 1, 3), np.ones((3, 2))
    path = tmp_path / "figure.png"
    draw_drop(path, t, [title, "b"], ones, np.ones((3, 2, 3)), ones, title=title)
    assert path.exists()


@pytest.mark.parametrize("arguments", [["list", "media", "\udcff"], ["drop", "\udcff.xml"]])
def test_an_argument_that_is_not_utf8(
    capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    assert main(arguments) == 2
    assert "an argument is not UTF-8" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["evaluate", "x" * 5000], ["impact", "--out", "x" * 5000]])
def test_a_path_that_is_too_long(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    assert main(arguments) == 2
    assert "too long" in capsys.readouterr().err


# Messages


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("sand", "'sand'"),
        ("x" * 200, repr("x" * 77 + "...")),
        ("\x1b", r"'\x1b'"),
        (12, "12"),
        (10**5000, "a number of 16610 bits"),
        (None, "None"),
        (1.5, "1.5"),
        ([1, "a"], "[1, 'a']"),
        ([[1]], "a list of 1"),
        ([0] * 100, "a list of 100"),
        ({"a": 1}, "a table"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_values_are_shown_shortly(value: object, said: str) -> None:
    assert shown(value) == said


def test_a_message_is_one_line_of_bounded_length() -> None:
    message = str(InputError("a\nb\x1b[31m" + "x" * 9000))
    assert message.startswith(r"a b\x1b[31mxxx")
    assert len(message) == 2000
    assert message.isprintable()


def test_known_names_are_listed_as_far_as_a_message_bears() -> None:
    names = [f"body_{number}" for number in range(10_000)]
    error = UnknownNameError("body", "x" * 500, names)
    assert error.known == tuple(names)
    assert len(str(error)) <= 2000
    assert str(error).endswith("...")
    assert listed(["a", "b"]) == "a, b"
    assert listed([]) == "none"
