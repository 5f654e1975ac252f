"""Loads compiled programs into memory, and finds their functions.

A program is object code, kept in a file. To load it takes LLVM, but nothing of numba's: that is a
third of the time that a small simulation takes to start.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from mjgranular.kernel.fault import FAULT, publish
from mjgranular.kernel.folder import folders_to_read, folders_to_write, read, write
from mjgranular.kernel.fork import MEMORY

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


def can_be_kept(function: Callable[..., Any]) -> bool:
    """Whether there is a folder to write to."""
    return any(True for _ in folders_to_write(_source(function)))


def save(function: Callable[..., Any], name: str, stamp: object, code: Code) -> None:
    """Keeps a program for other processes, if that can be.

    It is there as a whole or not at all, also when two processes write it at once.

    Args:
        function: that the program begins with: where its source is.
        name: of the program.
        stamp: of its source.
        code: the program.
    """
    head = {"name": name, "stamp": repr(stamp), "needs": code.needs, "python": code.python}
    body = json.dumps(head).encode() + b"\n" + code.object_code
    for folder in folders_to_write(_source(function)):
        with suppress(OSError):
            write(_file(folder, name), _sum(body) + b"\n" + body)
            return


def load(function: Callable[..., Any], name: str, stamp: object) -> Code | None:
    """What was kept under that name and of that source, None if nothing was.

    Args:
        function: that the program begins with.
        name: of the program.
        stamp: of its source.
    """
    for folder in folders_to_read(_source(function)):
        with suppress(OSError, ValueError, KeyError, TypeError):
            checksum, _, body = (read(_file(folder, name)) or b"").partition(b"\n")
            if checksum == _sum(body):
                head, _, object_code = body.partition(b"\n")
                said = json.loads(head)
                if (said["name"], said["stamp"]) == (name, repr(stamp)):
                    return Code(object_code, tuple(said["needs"]), said["python"])
    return None


def _source(function: Callable[..., Any]) -> Path:
    return Path(function.__code__.co_filename)


def _file(folder: Path, name: str) -> Path:
    return folder / f"{name}.program"


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


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
        self._engine: Any = None

    def load(self, name: str, code: Code) -> int:
        with MEMORY:
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
