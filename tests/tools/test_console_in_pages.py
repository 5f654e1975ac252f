"""Commands in the pages run, one after the other as a reader types them, and print what is shown.

`test_command_line_page.py` has what docs/command-line.md shows.
"""

import functools
import re
import shlex
import shutil
from pathlib import Path

import pytest

from mjgranular.cli import main
from mjgranular.cli.view import ViewCommand
from mjgranular.learn.policies import shipped_policies
from mjgranular.medium.file import EXAMPLE
from mjgranular.picture.video import Film

ROOT = Path(__file__).resolve().parents[2]
MODELS = ROOT / "docs" / "models"
PAGES = {
    str(page.relative_to(ROOT)): page.read_text()
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
BLOCK = re.search(r"With `block.xml` as\n\n```xml\n(.+?)```", PAGES["docs/command-line.md"], re.S)[
    1
]
RFT3D = """
  rft3d:
    density: {value: 1500, source: weighed}
    internal_friction: {value: 0.6, source: guessed}
    surface_friction: {value: 0.3, source: guessed}
"""
# What makes a command short, in place of what the page has for these options.
SHORT = {
    "evaluate": "--seeds 2",
    "render": "--seconds 0.2 --width 160 --height 120 --fps 5",
    "sweep": "--workers 1",
    "train": "--total-steps 64 --set n_steps=32 num_envs=2 batch_size=64",
}
# Their numbers are compared in test_command_line_page.py.
MEASURED = ("intrude --direction 0 --tilt 60", "intrude --intruder sphere --depth")
RUNS = {  # that docs/training.md takes for granted; policies of the package stand for them
    "runs/a": "ChainSwim-v0/ppo-0",
    "runs/b": "ChainSwim-v0/ppo-1",
    "runs/c": "ChainSwim-v0/ppo-2",
    "runs/Hexapod-v0-ppo-0": "Hexapod-v0/ppo-0",
    "runs/Hopper-v5-ppo-0": "Hopper-v0/ppo-0",
}


def commands(text):
    """The command lines of `mjgranular` in a page, without what is before and behind them."""
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    return re.findall(r"^mjgranular (.*?)(?: +[#>].*)?$", "\n".join(lines), re.M)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with the models of the pages, the current one."""
    shutil.copytree(MODELS, tmp_path, dirs_exist_ok=True)
    (tmp_path / "block.xml").write_text(BLOCK)
    robot = (tmp_path / "quad.xml").read_text().replace('pos="0 0 0.3"', 'pos="0 0 0.1"')
    robot = robot.replace("foot_lf", "left_foot").replace("foot_rf", "right_foot")
    keyframe = '<keyframe><key name="stand"/></keyframe></mujoco>'
    floor = re.search(r"<geom name=\"floor\".*?/>", robot)[0]
    deep = floor.replace("/>", ' pos="0 0 -1"/>')  # the pages drop this robot without --instead-of
    robot = robot.replace(floor, deep).replace("</mujoco>", keyframe)
    (tmp_path / "robot.xml").write_text(robot)
    (tmp_path / "my_sand.yaml").write_text(EXAMPLE.rstrip() + RFT3D)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(ViewCommand, "run", lambda self: 0)  # a window
    for command in ("impact", "drop"):  # with --video, which takes no size
        small = functools.partial(Film, width=160, height=120, fps=5)
        monkeypatch.setattr(f"mjgranular.cli.{command}.Film", small)
    return tmp_path


def prepare(page, place):
    """What a page takes for granted."""
    if page == "docs/training.md":
        for where, name in RUNS.items():
            shutil.copytree(shipped_policies()[name].path, place / where)
    if page == "docs/environments.md":
        (task,) = re.findall(r"```python\n([^`]+class HexapodVelocity[^`]+)```", PAGES[page])
        (place / "my_module.py").write_text(task)


def shortened(command):
    """The words of a command, and what makes it short."""
    words = shlex.split(command)
    if "--resume" in words:
        return with_options(words, "--total-steps 128") if "--total-steps" in words else words
    if words[0] == "sweep":
        words = words if "--of" in words else [*words, "--of", "impact --timestep 5e-5"]
    return with_options(words, SHORT.get(words[0], ""))


def with_options(words, options):
    """A command with these options, in place of those of the same name."""
    for option in re.findall(r"--[a-z-]+", options):
        if option in words:
            first = words.index(option)
            following = words[first + 1 :]
            count = next((k for k, word in enumerate(following) if word.startswith("--")), None)
            words = words[:first] + ([] if count is None else following[count:])
    return [*words, *options.split()]


@pytest.mark.slow
@pytest.mark.parametrize("page", [name for name, text in PAGES.items() if commands(text)])
def test_commands_run(page, place, capsys, registers):
    prepare(page, place)
    elsewhere = commands(PAGES["docs/training.md"]) if page == "docs/command-line.md" else ()
    for command in commands(PAGES[page]):
        if command in elsewhere:  # with all that it needs
            continue
        if command.startswith(MEASURED):
            continue
        refused = f"<!-- mjgranular {command} -->\n```text\nerror:" in PAGES[page]
        status = main(shortened(command))
        assert status == (2 if refused else 0), (command, capsys.readouterr().err)


QUOTED = [
    (page, command, shown)
    for page, text in PAGES.items()
    if page != "docs/command-line.md"
    for command, shown in re.findall(r"<!-- mjgranular (.+?) -->\n```text\n(.+?)```", text, re.S)
]


@pytest.mark.parametrize(("page", "command", "shown"), QUOTED)
def test_what_is_shown_is_printed(page, command, shown, place, capsys):
    status = main(shlex.split(command))
    out, err = capsys.readouterr()
    error = shown.startswith("error:")
    assert status == (2 if error else 0)
    assert (err if error else out).split() == shown.split()
