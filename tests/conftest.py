"""What the tests share."""

from __future__ import annotations

import os

# Before numpy and torch, and for processes that tests start: where several workers share the cores,
# threads of one operation spin until the slowest of them is given a core.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Before mujoco: it chooses how to draw without a screen.
import mjgranular  # isort: skip  # noqa: F401
import importlib.util
import json
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import hypothesis
import mujoco
import pytest

from mjgranular import Medium, media, register_medium
from mjgranular.models import Link

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


# Modules that users of the pages and of the tests have beside them.
OWN_MODULES = ("my_quad", "my_helper", "quad")


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
