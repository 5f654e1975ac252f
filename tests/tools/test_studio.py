"""MuJoCo Studio's plugin: it loads as Studio loads it, and the sand acts there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mujoco.studio.launch_web", reason="MuJoCo Studio is not installed")

PLUGIN = Path(__file__).parents[2] / "scripts" / "studio" / "sand_plugin.py"
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

# The simulation's half, with a viewer that nobody looks at, and the panel without a window. What
# they find goes to a file: Studio's server prints from a thread of its own, into any line.
SCRIPT = """
import json
import sys
from pathlib import Path
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
    said = {"what": felt.what, "carried": felt.force[2] / weight, "depth": felt.depth}
    handle.dispatch(type(panel.wanted())(medium="moon"))
    said["bad"] = [sent[-1].model.nplugin, scene._what]
    handle.dispatch(type(panel.wanted())(memory=0.02))
    said["skins"] = handle.model.nskin
    handle.dispatch(type(panel.wanted())(law="rft3d scale=2"))
    said["again"] = [handle.model.nplugin, scene._what]
Path("said.json").write_text(json.dumps(said))
"""

PANEL = """
import json
import sys
from pathlib import Path
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
Path("said.json").write_text(json.dumps({"drawn": str(panel.wanted())}))
"""


def run(folder: Path, script: str, *arguments: object) -> dict[str, Any]:
    """What a script finds in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)],
        cwd=folder,  # where the panel keeps how its windows lie
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads((folder / "said.json").read_text(encoding="utf-8"))


def test_the_plugin_puts_sand_under_a_model(tmp_path: Path) -> None:
    path = tmp_path / "block.xml"
    path.write_text(MODEL, encoding="utf-8")
    said = run(tmp_path, SCRIPT, PLUGIN, path)
    assert said["what"] == "sand instead of floor"
    assert said["carried"] == pytest.approx(1.0, abs=5e-4)
    assert 0 < said["depth"] < 0.03
    plugins, sentence = said["bad"]
    assert plugins == 0
    assert sentence.startswith("no sand: no medium 'moon'; there are: ")
    assert said["skins"] == 1  # which prints are drawn with
    assert said["again"] == [1, "sand instead of floor"]


def test_the_panel_is_drawn(tmp_path: Path) -> None:
    assert run(tmp_path, PANEL, PLUGIN)["drawn"].startswith("SandWanted(medium=None, law=None")
