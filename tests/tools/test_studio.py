"""MuJoCo Studio's plugin: it loads as Studio loads it, and the sand acts there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mjgranular.cli import main
from mjgranular.studio import PLUGIN

pytest.importorskip("mujoco.studio.launch_web", reason="MuJoCo Studio is not installed")

MODEL = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="block" pos="0 0 0.05">
      <freejoint/>
      <geom name="block" type="box" size="0.05 0.03 0.02" density="2000"/>
    </body>
  </worldbody>
</mujoco>
"""

# The simulation's half, with a viewer that nobody looks at, and the panel without a window.
SCRIPT = """
import sys
import mujoco
from mujoco.studio import launch_web, messages, plugin, viewer_protocol

[scene, panel] = plugin.load_plugins([sys.argv[1]])

class Stepper(plugin.SimPlugin):
    @messages.handler
    def on_step(self, event: messages.StepEvent) -> None:
        mujoco.mj_step(event.model, event.data)

config = viewer_protocol.ViewerConfig(gfx="web")
with launch_web.launch(config, plugins=[Stepper(), scene]) as handle:
    sent, send = [], handle.send_to_viewer
    handle.send_to_viewer = lambda message: (sent.append(message), send(message))
    handle.dispatch(messages.LoadModelEvent(path=sys.argv[2]))
    for _ in range(300):
        handle.sync()
    felt = [one for one in sent if type(one).__name__ == "SandFelt"][-1]
    weight = 9.81 * handle.model.body("block").mass[0]
    print("what", felt.what)
    print("carried", round(felt.force[2] / weight, 3), 0 < felt.depth < 0.03)
    handle.dispatch(type(panel.wanted())(medium="moon"))
    print("bad", sent[-1].model.nplugin, scene._what)
    handle.dispatch(type(panel.wanted())(law="rft3d scale=2"))
    print("again", handle.model.nplugin, scene._what)
"""

PANEL = """
import sys
from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

[scene, panel] = plugin.load_plugins([sys.argv[1]])
context = imgui.CreateContext()
imgui.GetIO().DisplaySize = imgui.Vec2(800, 600)
imgui.GetIO().BackendFlags = int(imgui.BackendFlags.RendererHasTextures)
for _ in range(2):
    imgui.NewFrame()
    panel.on_build_gui(messages.BuildGuiEvent())
    imgui.Render()
imgui.DestroyContext(context)
print("drawn", panel.wanted())
"""


def run(folder: Path, script: str, *arguments: object) -> dict[str, str]:
    """What a script prints in a process of its own, by the first word of each line."""
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        cwd=folder,  # where the panel keeps how its windows lie
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(line.split(" ", 1) for line in done.stdout.splitlines() if " " in line)


def test_the_plugin_puts_sand_under_a_model(tmp_path: Path) -> None:
    path = tmp_path / "block.xml"
    path.write_text(MODEL, encoding="utf-8")
    said = run(tmp_path, SCRIPT, PLUGIN, path)
    assert said["what"] == "sand instead of floor"
    assert said["carried"] == "1.0 True"
    assert said["bad"].startswith("0 no sand: no medium 'moon'; there are: ")
    assert said["again"] == "1 sand instead of floor"


def test_the_panel_is_drawn(tmp_path: Path) -> None:
    assert run(tmp_path, PANEL, PLUGIN)["drawn"].startswith("SandWanted(medium=None, law=None")


def test_the_command_prints_its_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["studio"]) == 0
    assert Path(capsys.readouterr().out.strip()) == PLUGIN
    assert PLUGIN.is_file()
