"""MuJoCo's structs are laid out as described, whatever new memory contains."""

import os
import subprocess
import sys

import pytest

CHECK = """
from mjgranular.kernel.engine import check_layout
for struct in ("mjOption", "mjModel", "mjData", "mjvGeom"):
    check_layout(struct)
"""


@pytest.mark.parametrize("byte", [1, 253])
def test_new_memory_may_contain_anything(byte: int) -> None:
    """The C library of Linux fills it with the complement of this byte: not text, not a bool."""
    environment = os.environ | {"MALLOC_PERTURB_": str(byte)}
    done = subprocess.run(
        [sys.executable, "-c", CHECK], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
