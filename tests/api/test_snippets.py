"""Snippets of the pages that are not Python: they are read by what they are for."""

import re
from pathlib import Path

import mujoco
import pytest

from mjgranular.learn.settings import find_settings
from mjgranular.medium.file import EXAMPLE

ROOT = Path(__file__).resolve().parents[2]
MODEL = """
<mujoco>
  {}
  <option timestep="1e-4"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <geom name="tray" type="box" pos="0 0 -0.1" size="0.5 0.5 0.1"/>
    <body name="foot" pos="0 0 1"><freejoint/>
      <geom type="capsule" size="0.01 0.1"/>
      <body name="left toe" pos="0 0 0.3"><joint/><geom type="capsule" size="0.01 0.1"/></body>
    </body>
  </worldbody>
</mujoco>"""


def snippet(page, kind):
    text = (ROOT / page).read_text()
    return re.search(rf"^```{kind}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)[1]


def test_the_mjcf_of_the_plugin():
    model = mujoco.MjModel.from_xml_string(MODEL.format(snippet("docs/plugin.md", "xml")))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert data.time > 0


def test_the_medium_file():
    assert snippet("docs/media.md", "yaml").strip() == EXAMPLE.strip()


def test_the_settings_file(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(snippet("docs/training.md", "toml"))
    settings = find_settings("", file=file)
    assert (settings.algorithm, settings.total_steps) == ("ppo", 600_000)
    assert settings.environment["randomise"] == {"strength": [0.5, 2.0]}


@pytest.mark.parametrize("page", ["README.md", "docs/questions.md"])
def test_the_bibtex_entry_has_the_version_of_the_citation_file(page):
    version = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1]
    assert f"version = {{{version}}}" in snippet(page, "bibtex")
