"""Memory on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mjgranular import RenderError
from mjgranular.cli import main
from mjgranular.render import Tracks

BLOCK = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody><body name="block">
<freejoint/><geom type="box" size="0.05 0.04 0.03" mass="1"/></body></worldbody></mujoco>
"""


@pytest.fixture
def block(tmp_path: Path) -> str:
    (tmp_path / "block.xml").write_text(BLOCK)
    return str(tmp_path / "block.xml")


@pytest.mark.parametrize("memory", ["0.02", "cell=0.02 extent=1"])
def test_a_drop_with_memory(block: str, memory: str) -> None:
    assert main(["drop", block, "--duration", "0.05", "--memory", memory]) == 0


@pytest.mark.parametrize(
    ("memory", "told"),
    [("0", "cell must be a number above 0"), ("cell=1e-4", "would fit"), ("much", "'much'")],
)
def test_what_has_no_meaning_is_told(block: str, memory: str, told: str, capsys: Any) -> None:
    assert main(["drop", block, "--memory", memory]) == 2
    assert told in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_an_impact_with_memory(tmp_path: Path) -> None:
    """The print of a run until rest is as deep as the link lies, and its film shows it."""
    pytest.importorskip("matplotlib")
    from mjgranular.experiment.folder import read_impact
    from mjgranular.picture.video import Film, frames_of_impact

    words = (
        "impact --memory 0.005 --law link_distributed --until rest --duration 0.2 --timestep 5e-5"
    )
    assert main([*words.split(), "--speed", "2", "--out", str(tmp_path / "run")]) == 0
    impact, _, run, prints = read_impact(tmp_path / "run")
    assert impact.memory == "0.005"
    assert prints is not None
    middle = prints.node[:, 1] == 0
    newest = dict(zip(prints.node[middle, 0], prints.height[middle], strict=True))
    along = {i: newest.get(i, 0.0) for i in prints.node[:, 0]}
    places = sorted(along)
    at_the_end = np.interp(run.x[-1], 0.005 * np.array(places), [along[i] for i in places])
    assert at_the_end == pytest.approx(run.z[-1], abs=0.001)  # the axis at C

    untouched = Tracks(prints.t[:1], prints.end[:1] * 0, prints.node[:0], prints.height[:0])
    film = Film(camera="corner", width=320, height=240, seconds=0.1, fps=10, hold=0)
    try:
        with_prints, without = (
            list(frames_of_impact(film, impact, run, None, tracks)[1])[-1]
            for tracks in (prints, untouched)
        )
    except RenderError as error:
        pytest.skip(str(error))
    changed = np.abs(with_prints.astype(int) - without.astype(int)).max(axis=2) > 10
    assert changed.mean() > 0.001  # the furrow
