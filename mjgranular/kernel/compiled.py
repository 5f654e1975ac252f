"""Compiles kernels, and keeps what was compiled on disk."""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import cached_property
from typing import Any

from mjgranular.kernel.announcement import ALWAYS, ONCE, announcement, log
from mjgranular.kernel.apart import give_way, uncut
from mjgranular.kernel.compiler import compiling
from mjgranular.kernel.fork import PROGRAMS
from mjgranular.kernel.identity import PACKAGE_STAMP, digest, identity, machine, parts_of
from mjgranular.kernel.program import Program, can_be_kept, load, save


class Kernel:
    """A function that is compiled where it is used: see `compiled`.

    Called from Python it is compiled as it is, for the types of its arguments. What calls it in a
    kernel has it compiled as a part; what is compiled as a whole is a program (`program_of`).
    """

    def __init__(self, function: Callable[..., Any], *, inline: bool) -> None:
        self.py_func = function
        self._inline = inline
        functools.update_wrapper(self, function)

    @cached_property
    def part(self) -> Any:
        """As other kernels see it (`parts.Part`)."""
        from mjgranular.kernel.parts import Part

        return Part(self.py_func, inline=self._inline, tell=_begin)

    @property
    def _numba_type_(self) -> Any:
        return self.part._numba_type_

    @cached_property
    def _whole(self) -> Any:
        with compiling():
            from mjgranular.kernel.cache import Whole

        return Whole(self.py_func, inline=self._inline)

    @property
    def stats(self) -> Any:
        """What was compiled, and what loaded, of what Python called."""
        return self._whole.stats

    def __call__(self, *arguments: Any) -> Any:
        return self._whole(*arguments)


def compiled(function: Callable[..., Any], *, inline: bool = False) -> Kernel:
    """Compiles `function` in nopython mode when it is needed; later processes load it from disk.

    The machine code lies in `__pycache__` beside the source or, where that cannot be written, in
    the user's folder for caches (`NUMBA_CACHE_DIR` overrides both). Where neither can be written
    it is compiled once a process.

    Args:
        function: scalar arithmetic and loops over arrays, without Python objects, exceptions or
            arrays of its own. It may be made by a factory, with other kernels in its closure.
        inline: put its code where it is called. For small functions in loops over elements, and for
            those that hand on many numbers; more of it costs compile time.

    Returns:
        A kernel, called like `function`.
    """
    parts = parts_of(function)
    if parts:
        # numba names machine code by this and by a counter that begins anew in every process: code
        # of two kernels from one factory, loaded from the cache, would be taken for the same.
        function.__qualname__ = f"{function.__qualname__}_{digest(parts)}"
    return Kernel(function, inline=inline)


def _begin(function: Callable[..., Any]) -> None:
    """Before a part is compiled: between parts a compiler can be left."""
    give_way()
    log(function)


_programs: dict[tuple[Kernel, tuple[str, ...]], Program] = {}


def program_of(kernel: Kernel, *types: str) -> Program:
    """A kernel and all that it calls as a program, compiled now if it was not yet.

    Args:
        kernel: of numbers, which gives a number or nothing.
        types: of its arguments, by numba's names: `int64`, `int32`, `float64`.

    Raises:
        CompilerError: numba is missing, or cannot be used.
    """
    found = _programs.get((kernel, types))
    return uncut(lambda: _find(kernel, types)) if found is None else found


def _find(kernel: Kernel, types: tuple[str, ...]) -> Program:
    with PROGRAMS:
        found = _programs.get((kernel, types))
        if found is None:
            found = _programs[kernel, types] = _kept_or_made(kernel, types)
        return found


def _kept_or_made(kernel: Kernel, types: tuple[str, ...]) -> Program:
    function = kernel.py_func
    with compiling():
        made_for = (types, machine(), identity(kernel))
    name = f"{function.__module__}.{function.__qualname__}".replace("<", "").replace(">", "")
    name = f"{name.removeprefix('mjgranular.')}.{digest(made_for)}"
    kept = load(function, name, PACKAGE_STAMP)
    if kept is None:
        keeps = can_be_kept(function)
        announcement.tell(ONCE if keeps else ALWAYS)
        give_way()
        with compiling():
            from mjgranular.kernel import parts

            kept = parts.build(kernel.part, tuple(getattr(parts.types, t) for t in types), name)
        if keeps:
            save(function, name, PACKAGE_STAMP, kept)
    return Program(name, kept)


def entry(kernel: Kernel, *types: str) -> Callable[..., Any]:
    """The compiled function for exactly these argument types, compiled now if it was not yet.

    Calling it skips numba's choice among signatures, half of what a call from Python costs.
    """
    return program_of(kernel, *types).function
