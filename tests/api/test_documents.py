"""What a reader can run, runs: scripts, benchmarks, code in the pages, the site itself."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from mjgranular import laws, media

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PYTHON = re.compile(
    r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```)?", re.DOTALL | re.MULTILINE
)
NUMBER = re.compile(r"(?<![\w.])([-+]?\d+\.?\d*(?:e[-+]?\d+)?)(?![\w])")


def parts(text: str) -> list[str | float]:
    """Words and numbers."""
    words = (part for piece in NUMBER.split(text) for part in piece.split())
    return [float(part) if NUMBER.fullmatch(part) else part for part in words]


def about(shown: list[str | float]) -> list[object]:
    """Those numbers to three parts in a thousand: processors may round otherwise."""
    return [
        pytest.approx(part, rel=3e-3, abs=1e-13) if isinstance(part, float) else part
        for part in shown
    ]


@pytest.fixture
def registers(monkeypatch):
    """What a page registers is forgotten after the test."""
    for registry in (media, laws):
        monkeypatch.setattr(registry, "_things", dict(registry._things))


def run(*command: object, cwd: Path) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_impact_script(tmp_path):
    printed = run(ROOT / "scripts" / "impact.py", cwd=tmp_path)
    assert "7.37 ms" in printed
    assert len((ROOT / "scripts" / "impact.py").read_text().splitlines()) < 40


@pytest.mark.slow
def test_the_sweep_script(tmp_path):
    assert len(run(ROOT / "scripts" / "sweep.py", cwd=tmp_path).splitlines()) == 6


@pytest.mark.slow
def test_the_video_script(tmp_path):
    run(ROOT / "scripts" / "video.py", "film.mp4", "0.5", cwd=tmp_path)
    assert (tmp_path / "film.mp4").stat().st_size > 1000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_in_the_pages_runs_and_prints_what_is_shown(page, capsys, registers):
    """A block of text that follows one of Python is what that prints."""
    namespace: dict[str, object] = {"__name__": "__main__"}
    for code, shown in PYTHON.findall(page.read_text()):
        exec(compile(code, str(page), "exec"), namespace)
        printed = capsys.readouterr().out
        if shown:
            assert parts(printed) == about(parts(shown)), printed


def test_the_site_builds_without_warnings(tmp_path):
    run("-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path, cwd=ROOT)
    assert (tmp_path / "index.html").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_in_the_pages_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text()):
        assert (page.parent / target).exists(), target
