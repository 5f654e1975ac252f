"""Memory on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mjgranular.cli import main

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
