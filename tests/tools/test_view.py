"""`mjgranular view`: the model shown, the loop that follows the clock, and a real window."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from mjgranular import InputError, Plane, RenderError, Sand, UnknownNameError, add_sand
from mjgranular.cli import main
from mjgranular.cli.view import ViewCommand
from mjgranular.engine.instances import sands_in
from mjgranular.learn import environments
from mjgranular.learn.evaluate import make_baseline
from mjgranular.learn.film import Live
from mjgranular.picture import viewer
from mjgranular.picture.viewer import FRAME, Switch, check_display, follow

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

BLOCK = """
<mujoco>
  <option timestep="1e-3"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 .1"/>
    <body name="block" pos="0 0 0.3"><freejoint/><geom type="box" size=".1 .05 .03"/></body>
  </worldbody>
  <keyframe><key name="low" qpos="0 0 0.02 1 0 0 0"/></keyframe>
</mujoco>
"""


@pytest.fixture
def block(tmp_path: Path) -> Path:
    path = tmp_path / "block.xml"
    path.write_text(BLOCK)
    return path


def test_what_is_shown_moves_as_under_sand_of_ones_own(block: Path) -> None:
    shown = ViewCommand(model=block, instead_of=("floor",), surface_height=0.01).load()
    assert sands_in(shown) == ("sand",)
    assert shown.geom("floor").group == 5  # not to be seen in the plane of the sand
    bare = mujoco.MjModel.from_xml_string(BLOCK)
    bare.geom("floor").contype = bare.geom("floor").conaffinity = 0
    sand = Sand(bare, medium="quikrete_medium", surface=Plane(0.01))
    mine, theirs = mujoco.MjData(shown), mujoco.MjData(bare)
    for model, data in ((shown, mine), (bare, theirs)):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.qvel[2] = -1.0
    for _ in range(30):
        mujoco.mj_step(shown, mine)
        sand.step(theirs)
    assert theirs.qvel[2] > -0.9
    np.testing.assert_allclose(mine.qpos, theirs.qpos, rtol=1e-9, atol=1e-12)


def test_prints_are_shown(block: Path) -> None:
    assert ViewCommand(model=block, memory="0.02", instead_of=("floor",)).load().nskin == 1
    assert ViewCommand(model=block, instead_of=("floor",)).load().nskin == 0


def test_a_model_with_sand_is_shown_with_that(
    block: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = mujoco.MjSpec.from_string(BLOCK)
    add_sand(spec, medium="glass_beads", law="rft2d", name="mine")
    block.write_text(spec.to_xml())
    assert sands_in(ViewCommand(model=block).load()) == ("mine",)
    assert "contains sand" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"instead_of": ("flor",)}, "no geom of the model 'flor'; there are: floor"),
        ({"bodies": ("arm",)}, r"no body of the model 'arm'.*block"),
        ({"law": "linkk"}, "link_distributed"),
        ({"bed": "floor"}, "geom 'floor' is a plane"),
        ({"bed": "a", "height_field": "b"}, "not both"),
        ({"timestep": -1.0}, "positive"),
    ],
)
def test_mistakes_are_told(block: Path, options: dict[str, Any], said: str) -> None:
    with pytest.raises((InputError, UnknownNameError), match=said):
        ViewCommand(model=block, **options).load()


def test_a_file_that_is_none_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"MuJoCo cannot load nowhere\.xml"):
        ViewCommand(model=tmp_path / "nowhere.xml").load()


def test_without_a_display_the_command_says_so(
    block: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(["view", str(block)]) == 2
    assert "DISPLAY" in capsys.readouterr().err
    assert main(["view", str(block), "--speed", "0"]) == 2
    assert "the speed must be positive" in capsys.readouterr().err


def test_a_display_that_does_not_open_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":99999")
    monkeypatch.setitem(sys.modules, "glfw", SimpleNamespace(init=lambda: False))
    with pytest.raises(RenderError, match="no window can be opened here, DISPLAY is ':99999'"):
        check_display()


class Window:
    """Stands for the viewer: open for some pictures, with things done at some of them."""

    def __init__(self, clock: Clock, pictures: int, deeds: dict[int, Any]) -> None:
        self.clock, self.pictures, self.deeds = clock, pictures, deeds
        self.shown = 0

    def is_running(self) -> bool:
        return self.shown < self.pictures

    @contextmanager
    def lock(self) -> Iterator[None]:
        yield

    def sync(self) -> None:
        self.shown += 1
        self.deeds.get(self.shown, lambda: None)()


class Clock:
    """Time that passes only where it is slept through."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(viewer, "time", clock)
    return clock


@pytest.mark.parametrize("speed", [1.0, 0.1])
def test_the_simulation_goes_as_the_clock_does(clock: Clock, speed: float) -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data = mujoco.MjData(model)
    follow(Window(clock, 60, {}), model, data, Switch(speed=speed))
    assert data.time == pytest.approx(59 * FRAME * speed, abs=1.5e-3)


def test_it_is_held_let_go_and_begun_anew(clock: Clock) -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data, switch = mujoco.MjData(model), Switch()
    times: dict[str, float] = {}

    def press() -> None:
        times[f"pressed {len(times)}"] = data.time
        switch.press(ord(" "))
        switch.press(ord("x"))  # means nothing

    deeds = {10: press, 40: press, 50: lambda: mujoco.mj_resetData(model, data)}
    follow(Window(clock, 61, deeds), model, data, switch)
    held, released = times.values()
    assert held == released == pytest.approx(9 * FRAME, abs=1.5e-3)
    assert data.time == pytest.approx(10 * FRAME, abs=2e-3)


def test_what_cannot_keep_up_is_not_chased(clock: Clock) -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data = mujoco.MjData(model)

    def stall() -> None:
        clock.now += 3.0

    follow(Window(clock, 20, {10: stall}), model, data, Switch())
    assert data.time == pytest.approx(18 * FRAME, abs=2e-2)


def test_it_ends_by_itself(clock: Clock) -> None:
    model = mujoco.MjModel.from_xml_string(BLOCK)
    data = mujoco.MjData(model)
    window = Window(clock, 10_000, {})
    follow(window, model, data, Switch(), duration=0.5)
    assert window.shown == pytest.approx(0.5 / FRAME, abs=1)


def test_a_policy_goes_on_after_a_restart(clock: Clock) -> None:
    with ViewCommand(model=Path("Hexapod-v0/ppo-0"), on="randomise={}")._live() as live:
        model, data, places = live.model, live.data, []

        def note() -> None:
            places.append((data.time, data.qpos[0]))

        deeds = {59: note, 60: lambda: mujoco.mj_resetData(model, data), 61: note, 120: note}
        how = {"step": live.step, "restart": live.restart}
        follow(Window(clock, 121, deeds), model, data, Switch(command=live.command), **how)
    assert live.command is None  # it follows none
    (first, x), (begun, start), (second, end) = places
    assert first == pytest.approx(second, abs=0.05)
    assert begun <= 2 * FRAME + live._env.unwrapped.dt
    assert min(x, end) > start + 0.1  # it walks


@pytest.mark.usefixtures("robots")
def test_a_robot_is_driven_by_keys(clock: Clock) -> None:
    with ViewCommand(model=Path("Go1Velocity-v0/ppo-0"), on="randomise={}")._live() as live:
        command = live.command
        assert command is not None
        switch = Switch(command=command)
        for _ in range(20):
            switch.press(265)  # up
        assert command.values == [0.8, 0.0, 0.0]  # not beyond what the task has
        for key in (264, 263, 46, 47, 47, ord("x")):  # down, left, dot, slash
            switch.press(key)
        assert command.values == pytest.approx([0.7, -0.1, 0.2])
        window = Window(clock, 60, {30: lambda: switch.press(257)})  # enter
        seen = []
        window.deeds[29] = lambda: seen.append(live._env.unwrapped.data.qvel[:2].copy())
        follow(window, live.model, live.data, switch, step=live.step, restart=live.restart)
        assert np.linalg.norm(seen) > 0.3
        assert command.values == [0.0, 0.0, 0.0]
        assert np.linalg.norm(live.data.qvel[:2]) < 0.3


def test_an_agent_in_an_environment_of_gymnasium_is_shown(clock: Clock) -> None:
    with closing(environments.one("Hopper-v5", {"max_episode_steps": -1})) as env:
        live = Live(env, make_baseline("zero", "Hopper-v5", env), 0)
        assert live.camera["trackbodyid"] == 2
        how = {"step": live.step, "restart": live.restart}
        window = Window(clock, 90, {60: lambda: mujoco.mj_resetData(live.model, live.data)})
        follow(window, live.model, live.data, Switch(), **how)
    assert live.data.time == pytest.approx(0.5, abs=0.1)
    assert live._steps == pytest.approx(60, abs=12)
    with closing(environments.one("CartPole-v1", {})) as env, pytest.raises(InputError, match="of"):
        Live(env, make_baseline("zero", "CartPole-v1", env), 0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["Hexapod-v0/ppo-0", "--medium", "glass_beads"], "--medium is for models: use --on"),
        (["Hexapod-v0/ppo-0", "--draw", "forces"], "--draw is for models"),
        (["block.xml", "--on", "strength=2"], "--on is for policies"),
        (["Hexapod-v0/ppo-00"], "did you mean Hexapod-v0/ppo-0"),
        (["Hexapod-v0/ppo-0", "--on", "medum=1"], "no option 'medum'"),
        (["Hexapod-v0/ppo-0", "--seed", "-1"], "seed must be at least 0, not -1"),
        (["mjgranular/Hexapod-v0"], "is an environment: name a policy, or the folder of a run"),
    ],
)
def test_mistakes_with_policies(
    arguments: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("mjgranular.cli.view.check_display", lambda: None)
    assert main(["view", *arguments]) == 2
    assert said in capsys.readouterr().err


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """A display to open windows on: the machine's, or a virtual one."""
    if os.environ.get("DISPLAY"):
        yield os.environ["DISPLAY"]
        return
    server = shutil.which("Xvfb")
    if server is None:
        pytest.skip("no display, and no Xvfb to make one")
    reader, writer = os.pipe()
    arguments = [
        server,
        "-displayfd",
        str(writer),
        "-screen",
        "0",
        "320x240x24",
        "+extension",
        "GLX",
    ]
    process = subprocess.Popen([*arguments, "-nolisten", "tcp"], pass_fds=[writer])
    os.close(writer)
    with os.fdopen(reader) as pipe:
        number = pipe.readline().strip()
    if not number:
        pytest.skip("Xvfb does not start")
    yield f":{number}"
    process.terminate()
    process.wait()


@pytest.mark.parametrize("what", ["block.xml", "Hexapod-v0/ppo-0"])
def test_a_window_opens_on_a_display(what: str, block: Path, display: str) -> None:
    environment = {**os.environ, "DISPLAY": display}
    environment.pop("MUJOCO_GL", None)
    arguments = ["view", what, "--duration", "1"]
    if what == block.name:
        arguments = ["view", str(block), "--duration", "1", "--draw", "forces", "depth"]
        arguments += ["--instead-of", "floor"]
    code = f"from mjgranular.cli import main; raise SystemExit(main({arguments!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert "Space: pause" in done.stderr


def test_passive_viewer_of_sand_in_a_model(display: str) -> None:
    environment = {**os.environ, "DISPLAY": display}
    environment.pop("MUJOCO_GL", None)
    code = f"""
import threading
import mujoco, mujoco.viewer
from mjgranular import add_sand
spec = mujoco.MjSpec.from_string({BLOCK!r})
add_sand(spec, medium="quikrete_medium", draw="forces")
model = spec.compile()
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
with mujoco.viewer.launch_passive(model, data) as viewer:
    for _ in range(10):
        with viewer.lock():
            mujoco.mj_step(model, data)
        viewer.sync()
    assert viewer.is_running()
    assert data.qfrc_passive.any()
for thread in threading.enumerate():  # the viewer's still clears up, and must be through
    if thread is not threading.main_thread():
        thread.join(timeout=5.0)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
