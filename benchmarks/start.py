"""Cost of `import mjgranular` and of a process's first step, with cached kernels."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

from measure import Case, Group

_BEFORE = "import mujoco"
_MODEL = "from mjgranular.models import Link; m = Link().model(1e-5); d = mujoco.MjData(m)"
_CODES = {
    "import mujoco": _BEFORE,
    "import mjgranular": f"{_BEFORE}; import mjgranular",
    "first step by Sand.step": (
        f"{_BEFORE}; import mjgranular; {_MODEL}; mjgranular.Sand(m).step(d)"
    ),
    "first step by Sand.step, rft3d": (
        f"{_BEFORE}; import mjgranular; {_MODEL}; "
        "mjgranular.Sand(m, law='rft3d', medium='quikrete_medium', scheme='implicit').step(d)"
    ),
    "first step by the plugin": (
        f"{_BEFORE}; import mjgranular; from mjgranular.models import Link; s = Link().spec(); "
        "mjgranular.add_sand(s); m = s.compile(); mujoco.mj_step(m, mujoco.MjData(m))"
    ),
}


def _process(name: str, code: str) -> Case:
    command = [sys.executable, "-c", code]
    return Case(
        name,
        lambda: None,
        lambda: subprocess.run(command, check=True, capture_output=True),
        1,
    )


def _cases() -> Sequence[Case]:
    return [_process(name, code) for name, code in _CODES.items()]


GROUPS = (
    Group(
        "A process that starts",
        "A whole process of Python's, from start to end.",
        _cases,
        unit="ms",
    ),
)
