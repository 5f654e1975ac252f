"""The digest of the sources changes with each file that kernels are made of."""

import ast
import sys
from operator import eq
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mjgranular.kernel import digest

PACKAGE = Path(digest.__file__).parents[1]
OTHERS = ("calibrate", "picture", "warp")
"""Folders that call programs, or read structs or the source of kernels, and make none for numba."""


def folders_with_kernels():
    """Folders with a module that imports what kernels are made with."""
    found = set()
    for path in PACKAGE.glob("*/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith(
                ("mjgranular.kernel", "numba", "llvmlite")
            ):
                found.add(path.parent.name)
    return sorted(found - set(OTHERS))


@pytest.mark.parametrize("folder", folders_with_kernels())
def test_a_change_in_any_folder_with_kernels_changes_the_digest(folder, tmp_path):
    for path in (path for name in digest.FOLDERS for path in PACKAGE.joinpath(name).glob("*.py")):
        copy = tmp_path / path.relative_to(PACKAGE)
        copy.parent.mkdir(exist_ok=True)
        copy.write_bytes(path.read_bytes())
    before = digest.digest_of_sources(tmp_path)
    assert digest.digest_of_sources(tmp_path) == before == digest.digest_of_sources()
    changed = min(tmp_path.joinpath(folder).glob("*.py"))
    changed.write_bytes(changed.read_bytes() + b"\n")
    assert digest.digest_of_sources(tmp_path) != before


def test_all_folders_of_the_digest_exist():
    assert all(PACKAGE.joinpath(folder, "__init__.py").is_file() for folder in digest.FOLDERS)
    assert set(folders_with_kernels()) <= set(digest.FOLDERS)


SOURCE = """
import constants
from mjgranular.kernel import compiled

def from_closure(table):
    @compiled
    def kernel(x):
        return x * table[1]
    return kernel

@compiled
def from_module(x):
    return x * constants.TABLE[1]

@compiled
def from_globals(x):
    return x * TABLE[1]

kernels = from_closure(TABLE), from_module, from_globals
"""


@pytest.mark.parametrize("made", [tuple, np.array])
def test_a_kernel_has_another_name_with_another_constant(made, monkeypatch):
    constants = ModuleType("constants")
    monkeypatch.setitem(sys.modules, "constants", constants)
    names = []
    for last in (1.0, 1.0 + 1e-12, 1.0):
        constants.TABLE = made([0.5, last, *[0.0] * 2000])
        scope = {"TABLE": constants.TABLE}
        exec(SOURCE, scope)
        names.append([digest.stable_name(kernel) for kernel in scope["kernels"]])
    first, other, again = names
    assert first == again
    assert not any(map(eq, first, other))
