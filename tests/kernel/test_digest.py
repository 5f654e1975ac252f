"""The digest of the sources changes with each file that kernels are made of."""

import ast
from pathlib import Path

import pytest

from mjgranular.kernel import digest

PACKAGE = Path(digest.__file__).parents[1]
OTHERS = ("calibrate", "warp")
"""Folders that call programs, or read the source of kernels, and make none that numba compiles."""


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
