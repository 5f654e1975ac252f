"""Supported versions of numba, and the error for others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version

from mjgranular.errors import GranularError

TESTED = ("0.62", "0.68")
"""The first and the last version of numba that the tests were run with."""


class CompilerError(GranularError, RuntimeError):
    """Kernels cannot be compiled with the numba that is installed, or without one."""

    def __init__(self, error: BaseException) -> None:
        installed = _installed()
        which = "numba is not installed" if installed is None else f"numba {installed} cannot"
        does = "" if installed is None else " compile the kernels of mjgranular"
        super().__init__(
            f"{which}{does} ({type(error).__name__}: {_in_short(error)}); tested versions of "
            f"numba: {TESTED[0]} to {TESTED[1]}"
        )


class KernelError(GranularError, TypeError):
    """A kernel cannot be compiled, most likely one of a custom law or surface.

    numba's long message is its cause.

    Args:
        error: numba's error.
        what: sand that the kernel is for, in words.
    """

    def __init__(self, error: BaseException, what: str) -> None:
        lines = [_CODES.sub("", line).strip() for line in str(error).splitlines()]
        news = next((line for line in lines if line and not line.startswith(_NO_NEWS)), "")
        places = (_PLACE.search(line) for line in lines)
        found = [f"{place[1]}, line {place[2]}" for place in places if place]
        where = f", in {found[0]}" if found else ""
        super().__init__(
            f"numba cannot compile the kernels{what and ' for '}{what}: "
            f"{type(error).__name__}: {news}{where}"
        )


_CODES = re.compile(r"\x1b\[[0-9;]*m")  # colours of a terminal
_NO_NEWS = "Failed in nopython mode pipeline"
_PLACE = re.compile(r'File "([^"]+)", line (\d+)')


@contextmanager
def compiling(what: str = "") -> Iterator[None]:
    """Turn errors of numba into a short one that says what failed and where.

    Args:
        what: sand that is compiled for, in words.

    Raises:
        CompilerError: numba is missing, not a tested version, or cannot be imported.
        KernelError: a tested version cannot compile a kernel.
    """
    try:
        yield
    except (GranularError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, ImportError) or not _is_tested():
            raise CompilerError(error) from error
        raise KernelError(error, what) from error


def _installed() -> str | None:
    try:
        return version("numba")
    except PackageNotFoundError:
        return None


def _is_tested() -> bool:
    first, last = map(_numbers, TESTED)
    return first <= _numbers(_installed() or "0")[:2] <= last


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(".")[:2] if number.isdigit())


def _in_short(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else "no message"
