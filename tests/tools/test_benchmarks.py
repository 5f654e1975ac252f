"""The benchmarks: they run, compare like with like, and write what they found."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from mjgranular import Explicit, LinkLaw, Sand
from mjgranular.medium import get_medium
from mjgranular.models import Link

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def modules(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Imports a module of the benchmarks."""
    monkeypatch.syspath_prepend(FOLDER)
    return lambda name: __import__(name)


def run(folder: Path, *arguments: object) -> str:
    done = subprocess.run(
        [sys.executable, str(FOLDER / "run.py"), *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_family_is_measured_saved_compared_and_reported(
    modules: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    page = tmp_path / "page.md"
    page.write_text((FOLDER / "figures.md").read_text())
    before = page.read_text()
    options = ("--only", "interfaces", "--quick")
    run(tmp_path, *options, "--save", "figures.json", "--report", page)
    saved = json.loads((tmp_path / "figures.json").read_text())
    assert saved["machine"]["mujoco"] == mujoco.__version__
    for cases in saved["figures"].values():
        first, *others = cases.values()
        assert first["ratio"] == 1.0
        assert all(case["cost"] > 0 and case["ratio"] > 0 for case in others)
    head, mark, _ = before.partition("<!-- figures: written by benchmarks/run.py -->\n")
    end = before[before.index("<!-- end of figures -->") :]
    assert mark
    assert page.read_text().startswith(head + mark)
    assert page.read_text().endswith(end)
    assert page.read_text() != before
    assert "| the same law in NumPy | " in page.read_text()
    # Again, without measuring.
    again, titles = modules("run"), saved["figures"]

    def measured(group: Any, *_args: Any, **_options: Any) -> Any:
        return {name: again.measure.Figure(**case) for name, case in titles[group.title].items()}

    monkeypatch.setattr(again.measure, "measure", measured)
    compare = tmp_path / "figures.json"
    again.main(again.Options(only=("interfaces",), quick=True, compare=compare))
    assert "before" in capsys.readouterr().out


def test_numpy_sand_is_the_same_law(modules: Any) -> None:
    model = Link().model(1e-5)
    medium = get_medium("play_sand")
    law = LinkLaw.from_medium(medium)
    steppers = [
        Sand(model, law=law, scheme=Explicit(half_step=False)),
        modules("numpy_law").NumpySand(model, law, medium.density.value),
    ]
    ends = []
    for stepper in steppers:
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(500):
            stepper.step(data)
        ends.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9)


def test_turns_and_quartiles(modules: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    measure = modules("measure")
    now = [0.0]
    monkeypatch.setattr(measure.time, "perf_counter", lambda: now[0])
    log: list[str] = []

    def case(name: str, seconds: float) -> Any:
        def work() -> None:
            log.append(name)
            now[0] += seconds * (1 + len(log) // 3)  # the machine slows down

        return measure.Case(name, lambda: None, work, 10)

    group = measure.Group("", "", lambda: [case("a", 1.0), case("b", 2.0), case("c", 3.0)])
    figures = measure.measure(group, measure.Effort(turns=5, seconds=0.0))
    assert log[6:12] == ["a", "b", "c", "b", "c", "a"]
    assert figures["a"].ratio == 1.0
    assert figures["b"].ratio == pytest.approx(2.0, rel=0.3)
    assert figures["a"].cost_low <= figures["a"].cost <= figures["a"].cost_high


def test_a_page_without_a_place_is_told(modules: Any, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Nothing\n")
    report = modules("report")
    with pytest.raises(SystemExit, match="no place for figures"):
        report.around_figures(page)
    page.write_text(f"# Figures\n{report.BEGIN}\n\nold\n{report.END}\nEnd.\n")
    assert "old" not in report.page_of("new", *report.around_figures(page))
    page.write_text(report.page_of("new", *report.around_figures(tmp_path / "none.md")))
    assert report.around_figures(page) == ("", "\n")


@pytest.mark.slow
def test_a_robot_of_meshes_is_measured(tmp_path: Path) -> None:
    model = tmp_path / "gem.xml"
    model.write_text(
        """<mujoco><asset>
        <mesh name="gem" vertex="-.05 0 0 .06 0 .01 0 -.05 0 0 .07 0 .01 0 -.06 0 .01 .08"/>
        </asset><worldbody><geom name="floor" type="plane" size="1 1 1"/>
        <body pos="0 0 .1"><freejoint/><geom type="mesh" mesh="gem" mass=".1"/></body>
        </worldbody></mujoco>"""
    )
    done = subprocess.run(
        [sys.executable, str(FOLDER / "meshes.py"), str(model), "--states", "5"],
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    rows = [line.split("|")[1].strip() for line in done.stdout.splitlines()]
    assert rows == ["", "default", "resolution 6", "resolution 12", "resolution 24", "triangles"]
