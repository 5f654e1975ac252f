"""The package as a user gets it: built, installed in a fresh environment, run."""

import json
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = (
    "mjgranular/py.typed",
    "mjgranular/models/link.xml",
    "mjgranular/models/assets/sand.png",
    "mjgranular/envs/__init__.py",
    "mjgranular/envs/task.py",
    "mjgranular/models/worm.py",
    "mjgranular/models/policies/Hexapod-v0/ppo-0/policy.zip",
    "mjgranular/cli/main.py",
    "mjgranular/learn/settings/default.toml",
    "mjgranular/learn/settings/mjgranular/ChainSwim-v0.toml",
    "mjgranular/kernel/memory.py",
)


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dist")
    # The sdist from the checkout, the wheel from the sdist.
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(ROOT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_sdist_and_wheel_are_complete(built):
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    for file in FILES:
        assert file in names
    tops = {
        name.partition("/")[0] for name in names if not name.split("/")[0].endswith(".dist-info")
    }
    assert tops == {"mjgranular"}  # no top-level `envs` or `models`
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert {"LICENSE", "README.md", "CHANGELOG.md", "models/link.xml"} <= inside
    modules = {
        str(path.relative_to(ROOT / "mjgranular")) for path in (ROOT / "mjgranular").rglob("*.py")
    }
    assert {f"mjgranular/{module}" for module in modules} <= names


@pytest.mark.slow
def test_the_wheel_works_in_a_fresh_environment(built, tmp_path):
    (wheel,) = built.glob("*.whl")
    home = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(home)], check=True)
    scripts = home / ("Scripts" if sys.platform == "win32" else "bin")
    install = [sys.executable, "-m", "pip", "--python", scripts / "python", "install"]
    subprocess.run([*install, "-q", "--no-compile", wheel], check=True)
    done = subprocess.run(
        [scripts / "mjgranular", "impact", "--json"],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert json.loads(done.stdout)["stopped"] is True
    # Without extras: the numbers are written, and the install line for the figures is named.
    done = subprocess.run(
        [scripts / "mjgranular", "impact", "--out", "run"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 2
    assert "pip install 'mjgranular[figures]'" in done.stderr
    assert (tmp_path / "run" / "summary.json").exists()


def test_import_is_light():
    loaded = python("import mjgranular, sys; print(*sys.modules)").split()
    for package in ("gymnasium", "torch", "matplotlib", "mediapy", "tyro", "rich"):
        assert package not in loaded


def test_policies_are_listed_without_torch():
    code = "import sys; from mjgranular.cli import main; main(['list', 'policies', '--json'])"
    loaded = python(f"{code}; print(*sys.modules)").split()
    assert "torch" not in loaded
    assert '"Hopper-v0/ppo-0",' in loaded


def test_environments_are_registered_where_gymnasium_is_imported():
    make = "gymnasium.make('{}mjgranular/LinkDrop-v0').close()"
    python("import gymnasium, mjgranular; " + make.format(""))
    python("import gymnasium; " + make.format("mjgranular:"))
    for missing in ("imageio", "mujoco.batch"):
        python(f"import sys; sys.modules['{missing}'] = None; import gymnasium, mjgranular")


def test_public_names_exist_and_are_documented():
    import mjgranular

    public = [name for name in vars(mjgranular) if not name.startswith("_")]
    for name in ("Sand", "Medium", "LinkLaw", "Plane", "Explicit", "InputError"):
        assert name in public
        assert getattr(mjgranular, name).__doc__


def test_the_renderer_is_chosen_only_where_nobody_has():
    code = "import os; {before}; import mjgranular; print(os.environ.get('MUJOCO_GL'))"
    assert python(code.format(before="os.environ['MUJOCO_GL'] = 'off'")).strip() == "off"
    shown = python(
        code.format(before="os.environ.pop('MUJOCO_GL', 0); os.environ['DISPLAY'] = ':0'")
    )
    assert shown.strip() == "None"


@pytest.mark.slow
def test_kernels_come_from_the_cache_in_a_second_process():
    code = (
        "import logging, sys; logging.basicConfig(stream=sys.stdout, format='%(message)s')\n"
        "logging.getLogger('mjgranular').setLevel('INFO')\n"
        "import mujoco, mjgranular; from mjgranular.models import Link\n"
        "m = Link().model(1e-5)\n"
        "for law in ('link', 'link_distributed'):\n"
        "    d = mujoco.MjData(m); d.qpos[1] = -0.2; d.qvel[1] = -1\n"
        "    mjgranular.Sand(m, law=law, scheme='explicit').step(d); print(d.qvel)"
    )
    first, second = python(code).splitlines(), python(code).splitlines()
    assert not any("compiling" in line for line in second)
    assert [line for line in first if "compiling" not in line] == second
    assert second[0] != second[1]  # the two laws do not share machine code
