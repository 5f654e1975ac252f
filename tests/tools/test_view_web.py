"""`mjgranular view --web`: the page, its controls, and what a browser receives."""

from __future__ import annotations

import io
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("mjviser", reason="the extra web is not installed")
import msgspec
import trimesh
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from mjgranular import Bed, add_sand
from mjgranular.cli import main
from mjgranular.cli.view import ViewCommand
from mjgranular.envs.single import SandEnv
from mjgranular.picture.viewer import Command, Switch
from mjgranular.picture.web import Page
from mjgranular.render.material import COLOR

pytestmark = pytest.mark.filterwarnings("ignore::mjgranular.errors.FloorWarning")

BALL = """
<mujoco>
  <option timestep="1e-3"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="ball" pos="0 0 0.1"><freejoint/><geom size=".05" density="2500"/></body>
  </worldbody>
  <keyframe><key name="falls" qpos="0 0 0.08 1 0 0 0" qvel="0.5 0 -1 0 0 0"/></keyframe>
</mujoco>
"""


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.xml"
    path.write_text(BALL)
    return path


@pytest.fixture
def port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


class Browser(threading.Thread):
    """Opens a page when it is served, and keeps what it is sent until the page ends."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port = port
        self.page = ""
        self.messages: list[dict[str, Any]] = []
        self.start()

    def run(self) -> None:
        deadline = time.monotonic() + 1800  # of compiling, on a busy machine
        while not self.page and time.monotonic() < deadline:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{self.port}") as answer:
                    self.page = answer.read().decode()
            except OSError:
                time.sleep(0.05)
        protocol: Any = f"viser-v{viser.__version__}"
        address = f"ws://127.0.0.1:{self.port}"
        try:
            with connect(address, subprotocols=[protocol], max_size=None) as socket:
                for frame in socket:
                    size, packed = (int.from_bytes(frame[k : k + 8], "little") for k in (0, 8))
                    plain = zstandard.decompress(frame[16 : 16 + packed], max_output_size=size)
                    self.messages += msgspec.msgpack.decode(plain)["messages"]
        except (ConnectionClosed, OSError):
            pass

    def has(self, kind: str, value: str = "") -> bool:
        return any(m["type"] == kind and value in str(m.get("updates")) for m in self.messages)

    def received(self, kind: str, name: str) -> list[dict[str, Any]]:
        self.join(timeout=600)
        return [m for m in self.messages if m["type"] == kind and name in m.get("name", "")]

    def sand(self) -> list[Any]:
        """Meshes of sand, in the order in which they came."""
        found = self.received("GlbMessage", "/sand ")
        files = [io.BytesIO(message["props"]["glb_data"]) for message in found]
        return [trimesh.load(file, file_type="glb", force="mesh") for file in files]


def shown(model: mujoco.MjModel, port: int, steps: int = 0, **state: Any) -> Browser:
    """What a browser receives of a model, at first and after some steps."""
    data = mujoco.MjData(model)
    for name, value in state.items():
        getattr(data, name)[:] = value
    mujoco.mj_forward(model, data)
    browser, page = Browser(port), Page(model, data, Switch(held=True), "127.0.0.1", port)
    try:
        for done in ("first", "last"):
            page._due = 0.0  # of the next mesh
            page.sync()
            page._time.value = done
            wait_for(lambda done=done: browser.has("GuiUpdateMessage", done), page._server.flush)
            mujoco.mj_step(model, data, steps)
    finally:
        page.close()
    return browser


def wait_for(condition: Callable[[], bool], action: Callable[[], None]) -> None:
    latest = time.monotonic() + 600
    while not condition():
        assert time.monotonic() < latest
        action()
        time.sleep(0.02)


def test_a_page_is_served_while_the_command_runs(
    ball: Path, port: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    browsers = Browser(port), Browser(port)

    def is_running(page: Page) -> bool:
        waits = any(browser.is_alive() for browser in browsers)
        return waits and not all(browser.has("GlbMessage") for browser in browsers)

    monkeypatch.setattr(Page, "is_running", is_running)
    command = ["view", str(ball), "--web", "--port", str(port), "--instead-of", "floor"]
    assert main(command) == 0
    printed = capsys.readouterr()
    assert f"http://localhost:{port}" in printed.err
    assert printed.out == ""
    for browser in browsers:
        assert "<!doctype html>" in browser.page
        assert browser.sand()[0].visual.material.baseColorTexture is not None  # grains
    assert main(command) == 0  # at the same port again


def sunk(mesh: trimesh.Trimesh) -> int:
    """How many vertices are below the surface."""
    return int((mesh.vertices[:, 2] < -2e-3).sum())


def test_prints_are_shown_as_they_come(ball: Path, port: int) -> None:
    model = ViewCommand(model=ball, instead_of=("floor",), memory="0.02").load()
    browser = shown(model, port, 150, qpos=model.key_qpos[0], qvel=model.key_qvel[0])
    meshes = browser.sand()
    assert sunk(meshes[0]) < sunk(meshes[-1])  # walls around the sand are sunk from the start
    names = [message["name"] for message in browser.received("GlbMessage", "/sand ")]
    assert len(set(names)) == 2  # the old one is there until the new one is read


def test_what_has_not_changed_is_not_sent_again(ball: Path, port: int) -> None:
    model = ViewCommand(model=ball, instead_of=("floor",)).load()
    browser = shown(model, port)
    (sand,) = browser.sand()
    np.testing.assert_allclose(sand.vertices[:, 2], 0.0, atol=1e-6)
    assert np.ptp(sand.vertices[:, 0]) > 10.0
    assert not browser.received("GridMessage", "floor")  # it is not shown in the window either


def test_the_floor_of_an_environment_is_sand(port: int) -> None:
    model = SandEnv("Hexapod").model  # without memory it has a plane that looks so
    (sand,) = shown(model, port).sand()
    assert np.ptp(sand.vertices[:, 0]) > 10.0


def test_forces_and_depths_are_shown(ball: Path, port: int) -> None:
    model = ViewCommand(model=ball, instead_of=("floor",), draw=("forces", "depth")).load()
    browser = shown(model, port, qpos=[0, 0, 0.03, 1, 0, 0, 0])
    updates = [m for m in browser.messages if m["type"] == "SceneNodeUpdateMessage"]
    changed = {(m["name"].rpartition("/")[2], key) for m in updates for key in m["updates"]}
    assert {("forces", "points"), ("depth", "points"), ("depth", "colors")} <= changed


def test_a_bed_has_the_color_of_sand(port: int) -> None:
    spec = mujoco.MjSpec.from_string(BALL)
    box = mujoco.mjtGeom.mjGEOM_BOX
    spec.worldbody.add_geom(name="bed", type=box, size=[1, 1, 0.1], pos=[0, 0, -0.1], contype=0)
    add_sand(spec, surface=Bed("bed"), instead_of=("floor",), medium="quikrete_medium")
    (bed,) = shown(spec.compile(), port).received("GlbMessage", "world/group0")
    mesh = trimesh.load(io.BytesIO(bed["props"]["glb_data"]), file_type="glb", force="mesh")
    np.testing.assert_allclose(
        mesh.visual.vertex_colors[0, :3] / 255, np.power(COLOR[:3], 2.2), atol=0.01
    )


def test_controls(ball: Path, port: int) -> None:
    model = ViewCommand(model=ball, instead_of=("floor",)).load()
    data, switch = mujoco.MjData(model), Switch(speed=0.5)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    page = Page(model, data, switch, "127.0.0.1", port)
    try:
        mujoco.mj_step(model, data, 5)
        page.sync()
        assert (switch.held, switch.speed) == (False, 0.5)
        page._pause.value, page._speed.value, page._restart.value = True, 0.01, True
        page.sync()
        assert (switch.held, switch.speed) == (True, 0.01)
        assert data.time == 0.0
        np.testing.assert_allclose(data.qpos, model.key_qpos[0])
        mujoco.mj_step(model, data, 5)
        page.sync()
        assert data.time > 0.0
    finally:
        page.close()


def test_a_command_by_sliders(ball: Path, port: int) -> None:
    model = ViewCommand(model=ball, instead_of=("floor",)).load()
    command = Command(((-0.8, 0.8), (0.0, 0.0), (-1.0, 1.0)))
    switch = Switch(held=True, command=command)
    page = Page(model, mujoco.MjData(model), switch, "127.0.0.1", port)
    try:
        page._command[0].value, page._command[2].value = 0.5, -0.25
        page.sync()
    finally:
        page.close()
    assert command.values == [0.5, 0.0, -0.25]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--port", "0"), "the port must be from 1 to 65535, got 0"),
        (("--port", "99999"), "the port must be from 1 to 65535, got 99999"),
        (("--port", "8.5"), "must be an integer"),
        (("--host", "no.such.host.invalid"), "no page can be served at no.such.host.invalid"),
        (("--host", "a" * 300), "no page can be served at aaa"),
        (("--instead-of", "flor"), "there are: floor"),
    ],
)
def test_mistakes_are_errors_in_words(
    ball: Path, options: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = main(["view", str(ball), "--web", *options])
    except SystemExit as end:  # of the parser
        status = end.code
    assert status == 2
    printed = capsys.readouterr()
    assert said in " ".join((printed.err + printed.out).split())


def test_a_port_that_is_taken_is_an_error(
    ball: Path, port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", port)):
        assert main(["view", str(ball), "--web", "--port", str(port)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"error: no page can be served at 127.0.0.1, port {port}: ")
    assert error.count("\n") == 1


def test_an_unknown_model_is_an_error(capsys: pytest.CaptureFixture[str], port: int) -> None:
    assert main(["view", "nowhere.xml", "--web", "--port", str(port)]) == 2
    assert "cannot load nowhere.xml" in capsys.readouterr().err


@pytest.mark.parametrize("option", [("--port", "8081"), ("--host", "0.0.0.0")])
def test_an_address_without_a_page_is_an_error(
    ball: Path, option: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", str(ball), *option]) == 2
    assert "use --web" in capsys.readouterr().err


def test_without_the_extra_the_command_says_so(
    ball: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mjviser", None)
    assert main(["view", str(ball), "--web"]) == 2
    error = capsys.readouterr().err
    assert "mjviser, which is not installed: pip install 'mjgranular[web]'" in error


def test_an_interrupt_ends_it(ball: Path, port: int) -> None:
    code = (
        f"from mjgranular.cli import main; raise SystemExit(main({['view', str(ball), '--web']!r}"
    )
    code += f" + ['--port', '{port}', '--instead-of', 'floor']))"
    command = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True)
    with command:
        assert command.stderr is not None
        lines = iter(command.stderr.readline, "")
        assert any(f"localhost:{port}" in line for line in lines)
        command.send_signal(signal.SIGINT)
        assert command.wait(timeout=600) == 130
        assert command.stderr.read().endswith("error: interrupted\n")
