"""Loads compiled programs into memory, and finds their functions.

A program is object code, kept in a file. To load it takes LLVM, but nothing of numba's: that is a
third of the time that a small simulation takes to start.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import llvmlite.binding as llvm

from mjgranular.kernel.fault import FAULT, publish

_METH_FASTCALL = 0x80


@dataclass(frozen=True)
class Code:
    """A program as it is kept.

    Attributes:
        object_code: for this machine.
        needs: names of functions and of memory that it expects in the process.
        python: whether Python can call it.
    """

    object_code: bytes
    needs: tuple[str, ...]
    python: bool


def _folders(function: Callable[..., Any]) -> Iterator[Path]:
    """Where a program may be kept, the best place first."""
    source = Path(function.__code__.co_filename).resolve().parent
    own = f"mjgranular-{hashlib.sha256(str(source).encode()).hexdigest()[:16]}"
    told = os.environ.get("NUMBA_CACHE_DIR")
    if told:
        yield Path(told) / own
        return
    yield source / "__pycache__"
    with suppress(RuntimeError):  # who has no home
        home = Path.home()
        caches = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
        base = os.environ.get("XDG_CACHE_HOME") or home / caches
        yield Path(base) / "mjgranular" / own


def can_be_kept(function: Callable[..., Any]) -> bool:
    """Whether there is a folder to write to."""
    return any(map(_is_writable, _folders(function)))


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def save(function: Callable[..., Any], name: str, stamp: object, code: Code) -> None:
    """Keeps a program for other processes, if that can be.

    It is there as a whole or not at all, also when two processes write it at once.

    Args:
        function: that the program begins with: where its source is.
        name: of the program.
        stamp: of its source.
        code: the program.
    """
    head = {
        "stamp": repr(stamp),
        "sum": _sum(code.object_code),
        "needs": code.needs,
        "python": code.python,
    }
    content = json.dumps(head).encode() + b"\n" + code.object_code
    for folder in _folders(function):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            written = folder / f"{name}.{uuid4().hex[:16]}"
            try:
                written.write_bytes(content)
                written.replace(folder / f"{name}.program")
            except OSError:
                written.unlink(missing_ok=True)
                raise
            return


def load(function: Callable[..., Any], name: str, stamp: object) -> Code | None:
    """What was kept under that name and of that source, None if nothing was.

    Args:
        function: that the program begins with.
        name: of the program.
        stamp: of its source.
    """
    for folder in _folders(function):
        with suppress(OSError, ValueError, KeyError):
            head, _, object_code = (folder / f"{name}.program").read_bytes().partition(b"\n")
            said = json.loads(head)
            if (said["stamp"], said["sum"]) == (repr(stamp), _sum(object_code)):
                return Code(object_code, tuple(said["needs"]), said["python"])
    return None


def _sum(code: bytes) -> str:
    return hashlib.sha256(code).hexdigest()


class _Method(ctypes.Structure):
    """`PyMethodDef` of Python's methodobject.h."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


_new_function = ctypes.pythonapi.PyCFunction_NewEx
_new_function.restype = ctypes.py_object
_new_function.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


class Program:
    """A compiled program in memory, as long as the process lives.

    Attributes:
        address: of its function, in C's calling convention.
    """

    def __init__(self, name: str, code: Code) -> None:
        self.address = _memory.load(name, code)
        self._name, self._code = name, code
        self._python: Callable[..., Any] | None = None

    @property
    def function(self) -> Callable[..., Any]:
        """The same for Python.

        Raises:
            TypeError: it takes or gives what is no number of 64 bits.
        """
        if not self._code.python:
            raise TypeError(f"{self._name} takes or gives what is no number of 64 bits")
        if self._python is None:
            address = _memory.address(f"{self._name}.python")
            self._method = _Method(self._name.encode(), address, _METH_FASTCALL, None)
            self._python = _new_function(ctypes.addressof(self._method), None, None)
        assert self._python is not None
        return self._python


def _missing(code: Code) -> list[str]:
    return [name for name in code.needs if not llvm.address_of_symbol(name)]


class _Memory:
    """Where programs lie."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._engine: Any = None

    def load(self, name: str, code: Code) -> int:
        with self._lock:
            if self._engine is None:
                llvm.initialize_native_target()
                llvm.initialize_native_asmprinter()
                machine = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
                    jit=True
                )
                self._engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
            if FAULT in code.needs:
                publish()
            if _missing(code):  # numba has helpers of its own, which it publishes with all the rest
                from numba.core.registry import cpu_target

                context: Any = cpu_target.target_context
                context.refresh()
            if _missing(code):  # to load it would end the process
                lacks = ", ".join(_missing(code))
                raise ImportError(f"{name} needs {lacks}, which the process does not have")
            self._engine.add_object_file(llvm.ObjectFileRef.from_data(code.object_code))
            self._engine.finalize_object()
            return self._engine.get_function_address(name)

    def address(self, name: str) -> int:
        return self._engine.get_function_address(name)


_memory = _Memory()
