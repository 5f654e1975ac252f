"""What a reader can run, runs: scripts, benchmarks, code in the pages, the site itself."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


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
def test_code_in_the_pages_runs(page):
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block in blocks:
        exec(compile(block, str(page), "exec"), namespace)


def test_the_site_builds_without_warnings(tmp_path):
    run("-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path, cwd=ROOT)
    assert (tmp_path / "index.html").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_in_the_pages_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text()):
        assert (page.parent / target).exists(), target
