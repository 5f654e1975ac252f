"""What a reader can run, runs: scripts, benchmarks, code in the pages, the site itself."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import mjgranular
from mjgranular import errors

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
QUICK = ("README.md", "docs/conventions.md", "docs/index.md", "docs/media.md", "docs/shapes.md")
PYTHON = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```)?", re.DOTALL | re.MULTILINE)


def run(*command: object, cwd: Path) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def models(tmp_path, monkeypatch):
    """The models of the pages, in the current folder."""
    shutil.copytree(ROOT / "docs" / "models", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


@pytest.mark.slow
def test_the_scripts_for_stable_baselines3(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the extra train is not installed")
    env = "mjgranular/Hopper-v0"  # it falls soon: ten episodes to evaluate are short
    run(ROOT / "scripts" / "train.py", env, "2048", "policy", cwd=tmp_path)
    assert (tmp_path / "policy" / "normalizer.pkl").exists()
    printed = run(ROOT / "scripts" / "evaluate.py", env, "policy", cwd=tmp_path)
    assert re.fullmatch(rf"{env}: \S+, standard deviation \S+\n", printed)


TUNE = ("Pendulum-v1", "--total-steps", "64", "--trials", "2")
TUNE += ("--set", "num_envs=1", "n_steps=64", "batch_size=64", "environment.max_episode_steps=20")


@pytest.mark.slow
def test_the_tuning_script(tmp_path):
    pytest.importorskip("optuna", reason="the extra tune is not installed")
    script = ROOT / "scripts" / "tune.py"
    assert len(script.read_text().splitlines()) <= 80
    printed = run(script, *TUNE, "--out", "tuned", cwd=tmp_path)
    assert printed.startswith("best of 2: trial-")
    assert "--set num_envs=1 n_steps=64 batch_size=64 environment.max_episode_steps=20 " in printed
    assert (tmp_path / "tuned" / "trial-1" / "policy.zip").exists()
    assert run(script, *TUNE, "--out", "tuned", cwd=tmp_path).startswith("best of 4: trial-")
    folders = (tmp_path / "tuned" / f"trial-{number}" for number in range(4))
    tried = {
        json.loads((each / "config.json").read_text())["settings"]["arguments"]["gamma"]
        for each in folders
    }
    assert len(tried) == 4  # the same command tries others
    more = subprocess.run(
        [sys.executable, script, *TUNE, "batch_size=32", "--out", "tuned"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert more.returncode == 1
    assert re.search(
        r"error: tuned has trials of Pendulum-v1 64 steps.*use another --out", more.stderr
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trials", "answer", "message"),
    [
        ("0", "0.0", "error: --trials must be at least 1, not 0\n"),
        ("1", "stop()", "error: interrupted; the same command adds to tuned\n"),
        ("1", "fail()", "error: no trial was finished: all were unstable\n"),
    ],
)
def test_the_tuning_script_without_a_finished_trial(trials, answer, message, tmp_path):
    pytest.importorskip("optuna", reason="the extra tune is not installed")
    code = f"""import sys
sys.path.insert(0, {str(ROOT / "scripts")!r})
import tune
def stop(): raise KeyboardInterrupt
def fail(): raise tune.UnstableError("diverged")
tune.run_trial = lambda trial, options: {answer}
sys.argv = ["tune.py", "Pendulum-v1", "--trials", {trials!r}]
tune.main()"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 1
    assert done.stderr.endswith(message)
    assert "in main" not in done.stderr


def test_the_tuning_script_without_optuna_gives_the_install_line(tmp_path, monkeypatch):
    (tmp_path / "optuna.py").write_text("raise ModuleNotFoundError(name='optuna')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    command = [sys.executable, ROOT / "scripts" / "tune.py", *TUNE]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "pip install 'mjgranular[tune]'" in done.stderr


@pytest.mark.slow
def test_the_gait_search_script(tmp_path):
    script = ROOT / "scripts" / "search_gait.py"
    ranges = ("amplitude=0.2:1", "frequency=0.5:6", "waves=-1:1")
    few = ("--count", "8", "--on", "max_episode_steps=10", "--by", "x_velocity")
    printed = run(script, "mjgranular/ChainCrawl-v0", *ranges, *few, cwd=tmp_path)
    speeds = [float(line.split()[1].rstrip(":")) for line in printed.splitlines()]
    assert len(speeds) == 5
    assert speeds == sorted(speeds, reverse=True)


@pytest.mark.slow
def test_the_rllib_script(tmp_path):
    pytest.importorskip("ray.rllib", reason="the extra ray is not installed")
    script = ROOT / "scripts" / "train_rllib.py"
    # Episodes of a hopper end within one iteration.
    printed = run(script, "mjgranular/Hopper-v0", "1", "policy", cwd=tmp_path)
    assert re.match(r"1: 4\d{3} steps, mean return \S+\n", printed)
    assert (tmp_path / "policy" / "rllib_checkpoint.json").exists()


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=name, marks=() if name in QUICK else pytest.mark.slow)
        for page in PAGES
        for name in [str(page.relative_to(ROOT))]
    ],
)
def test_code_in_the_pages_runs_and_prints_what_is_shown(
    page, capsys, registers, models, check_printed, request
):
    """A block of text that follows one of Python is what that prints."""
    if 'Go1Velocity-v0", ' in page.read_text():
        request.getfixturevalue("robots")
    namespace: dict[str, object] = {"__name__": "__main__"}
    for code, shown in PYTHON.findall(page.read_text()):
        if "mujoco.studio" in code:
            pytest.importorskip("mujoco.studio", reason="a part of MuJoCo 4")
        exec(compile(code, str(page), "exec"), namespace)
        printed = capsys.readouterr().out
        if shown:
            check_printed(printed, shown)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The pages of the site, built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    run("-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder, cwd=ROOT)
    return {str(page.relative_to(folder)): page.read_text() for page in folder.rglob("*.html")}


@pytest.mark.slow
def test_pages_need_nothing_from_elsewhere(site):
    assert "index.html" in site
    for page, text in site.items():
        assert not re.search(r"<(?:script|link|img|video)[^>]+(?:src|href)=\"?https?:", text), page


@pytest.mark.slow
def test_formulas_are_markup(site):
    """None is left to a script."""
    assert "<math" in site["laws/link.html"]
    assert [page for page, text in site.items() if "arithmatex" in text] == []


@pytest.mark.slow
def test_the_reference_is_made_from_docstrings(site):
    text = site["reference/sand.html"]
    assert "One <code>Sand</code> serves any number of <code>MjData</code>" in text


@pytest.mark.slow
def test_notebooks_are_pages(site):
    assert "torso at" in site["notebooks/own_robot.html"]
    assert 'href="notebooks/own_robot.html"' in site["index.html"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_in_the_pages_lead_somewhere(page):
    text = page.read_text()
    films = re.findall(r'(?:src|poster)="([^"]+)"', text)
    links = re.findall(r'href="(?!https?:|#)([^"#]+)', text)  # HTML, to pages of the site
    films += [target.replace(".html", ".md") for target in links]
    for target in films + re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text):
        assert (page.parent / target).exists(), target


def test_the_reference_has_all_public_names():
    pages = "".join(page.read_text() for page in (ROOT / "docs" / "reference").glob("*.md"))
    listed = set(re.findall(r"^::: mjgranular\.(?:errors\.)?(\w+)$", pages, re.MULTILINE))
    public = {
        name
        for name, thing in vars(mjgranular).items()
        if not name.startswith("_") and not isinstance(thing, ModuleType)
    }
    public |= {name for name in vars(errors) if name.endswith(("Error", "Warning"))}
    assert public <= listed, public - listed
