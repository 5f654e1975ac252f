"""What the attacks share: child processes that may crash, and the modules of `scripts/attacks`."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
if str(SCRIPTS) not in sys.path:
    sys.path.insert(0, str(SCRIPTS))

# What is run after a script of a test, which defines `run(*case)`: one case after the other.
_LOOP = """
import json, sys
for case in json.loads(sys.argv[1]):
    print(json.dumps({"case": case}), flush=True)
    print(json.dumps({"told": run(*case)}), flush=True)
"""


@pytest.fixture
def survive(tmp_path: Path) -> Callable[[str, Sequence[Any]], list[Any]]:
    """Runs cases one after the other in a process of its own; gives what each has returned.

    The process must come to its end: if it does not, the case that it was at is told.
    """

    def survive(script: str, cases: Sequence[Any]) -> list[Any]:
        done = subprocess.run(
            [sys.executable, "-X", "faulthandler", "-c", script + _LOOP, json.dumps(list(cases))],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=300,
        )
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        at = rows[-1].get("case") if rows else None
        assert done.returncode == 0, f"ended with {done.returncode} at {at}\n{done.stderr[-3000:]}"
        return [row["told"] for row in rows if "told" in row]

    return survive
