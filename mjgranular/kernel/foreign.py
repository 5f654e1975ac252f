"""What kernels call beside kernels: functions of C, and instructions of the processor.

numba's own `intrinsic` and `ExternalFunction`, made when a kernel that calls them is compiled: to
load numba takes longer than to load programs that have been compiled.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any


class Intrinsic:
    """A function that says itself how it is translated.

    Args:
        define: `define(typingctx, *types)`: numba's signature, and a function that writes the code
            (`numba.extending.intrinsic`).
    """

    def __init__(self, define: Callable[..., Any]) -> None:
        self._defn = define

    @cached_property
    def _numba_type_(self) -> Any:
        from numba.core.registry import cpu_target
        from numba.extending import intrinsic

        self._made: Any = intrinsic(self._defn)
        context: Any = cpu_target.typing_context
        context.refresh()
        return context.resolve_value_type(self._made)


class External:
    """A function of C's in this process.

    Args:
        name: under which LLVM knows it.
        result: numba's name of the type of its result, `void` for none.
        arguments: the same of its arguments; a pointer is an `int64`.
    """

    def __init__(self, name: str, result: str, *arguments: str) -> None:
        self._name = name
        self._types = (result, *arguments)

    def __repr__(self) -> str:
        return f"External({self._name!r}, {self._types})"

    def __call__(self, *arguments: Any) -> Any:
        raise TypeError(f"{self._name} is called by kernels alone")

    @cached_property
    def _numba_type_(self) -> Any:
        from numba import types

        result, *arguments = (getattr(types, name) for name in self._types)
        return types.ExternalFunction(self._name, result(*arguments))
