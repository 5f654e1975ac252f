"""The structure of the package: folders stand on each other in one order, without circles.

Sources are parsed, not imported, so an import within a function counts as one at the top does.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "mjgranular": ROOT / "mjgranular",
    "mjgranular.models": ROOT / "models",
    "mjgranular.envs": ROOT / "envs",
    "": ROOT / "referee",  # scripts, which import each other by their bare names
}

# From the ground up: a folder may import those in the lines above it. Modules beside the folders
# rank as "_util"; "mjgranular" is the public interface, which is built on the engine. Scripts of
# the referee are above all of them.
ORDER = (
    "_util",
    "pool",
    "medium",
    "kernel",
    "shape",
    "surface",
    "relief",
    "law",
    "scheme",
    "sand",
    "render",
    "engine",
    "warp",
    "mjgranular",
    "models",
    "envs",
    "experiment",
    "calibrate",
    "picture",
    "learn",
    "cli",
)


ALIASES = {"fit": "calibrate", "referee": "calibrate"}
"""Modules that only import names of a folder, which they rank with."""


@dataclass(frozen=True)
class Import:
    """An import of `module`, or of `name` from it."""

    module: str
    name: str
    line: int

    @property
    def path(self) -> str:
        return f"{self.module}.{self.name}" if self.name else self.module


@cache
def trees() -> dict[str, ast.Module]:
    """The syntax trees of all modules of the package, by name."""
    found = {}
    for package, folder in PACKAGES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = [package, *file.relative_to(folder).with_suffix("").parts]
            name = ".".join(part for part in parts if part not in ("", "__init__"))
            found[name] = ast.parse(file.read_text(encoding="utf-8"))
    return found


def imports_of(node: ast.AST) -> Iterator[Import]:
    """All imports below a node of a syntax tree."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for alias in child.names:
                yield Import(alias.name, "", child.lineno)
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0, f"relative import in line {child.lineno}"
            for alias in child.names:
                yield Import(str(child.module), alias.name, child.lineno)
        yield from imports_of(child)


@cache
def imports() -> dict[str, list[Import]]:
    """The imports of all modules of the package, by name."""
    return {name: list(imports_of(tree)) for name, tree in trees().items()}


def within_the_package(module: str) -> set[str]:
    """The modules of the package that one of them imports."""
    named = {one.path if one.path in trees() else one.module for one in imports()[module]}
    return named & trees().keys()


def rank(module: str) -> int:
    parts = module.split(".")
    if parts[0] != "mjgranular" or parts[-1] == "__main__":
        return len(ORDER)
    if len(parts) == 1:
        return ORDER.index("mjgranular")
    folder = ALIASES.get(parts[1], parts[1])
    return ORDER.index(folder) if folder in ORDER else ORDER.index("_util")


def test_every_folder_has_its_place_in_the_order() -> None:
    folders = {file.parent.name for file in (ROOT / "mjgranular").glob("*/__init__.py")}
    assert folders | {"mjgranular", "models", "envs"} == set(ORDER)


def test_a_folder_imports_only_folders_below_it() -> None:
    up = {
        (module, imported)
        for module in trees()
        for imported in within_the_package(module)
        if rank(imported) > rank(module)
    }
    assert up == set()


def test_modules_do_not_import_each_other_in_circles() -> None:
    graph = {module: within_the_package(module) - {module} for module in trees()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def of_the_compiler(path: str) -> bool:
    return path.split(".")[0] in ("numba", "llvmlite")


def underscored_of_the_compiler(module: str) -> Iterator[str]:
    """Underscored names of numba and llvmlite: imported, or read in a class made from theirs."""
    theirs = {
        found.name or found.module for found in imports()[module] if of_the_compiler(found.path)
    }
    for found in imports()[module]:
        if of_the_compiler(found.path) and any(p.startswith("_") for p in found.path.split(".")):
            yield f"{module}:{found.line}: {found.path}"
    for node in ast.walk(trees()[module]):
        bases = [ast.unparse(base) for base in node.bases] if isinstance(node, ast.ClassDef) else []
        if not any(base.split(".")[0] in theirs for base in bases):
            continue
        private: dict[type, set[str]] = {ast.Load: set(), ast.Store: set()}
        for inner in ast.walk(node):
            if isinstance(inner, ast.Attribute) and ast.unparse(inner.value) in ("self", "super()"):
                private.setdefault(type(inner.ctx), set()).add(inner.attr)
            elif isinstance(inner, ast.FunctionDef):
                private[ast.Store].add(inner.name)
            elif isinstance(inner, ast.Name) and isinstance(inner.ctx, ast.Store):
                private[ast.Store].add(inner.id)
        for name in sorted(private[ast.Load] - private[ast.Store]):
            if name.startswith("_") and not name.startswith("__"):
                yield f"{module}:{node.lineno}: {bases[0]}.{name}"


def test_no_underscored_name_of_numba() -> None:
    found = [name for module in trees() for name in underscored_of_the_compiler(module)]
    assert not found, "\n".join(found)


def test_llvmlite_binding_in_one_module_at_most() -> None:
    binding = {
        module
        for module, found in imports().items()
        if any(f"{one.path}.".startswith("llvmlite.binding.") for one in found)
    }
    assert len(binding) <= 1, sorted(binding)
