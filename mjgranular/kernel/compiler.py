"""Versions of numba that are known to work, and the error where another one does not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version

from mjgranular.errors import GranularError

TESTED = ("0.62", "0.68")
"""The first and the last version of numba that the tests have been run with."""


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


@contextmanager
def compiling() -> Iterator[None]:
    """Says of what goes wrong with numba that it is numba's.

    An error in a law of somebody's own stays what it is, where numba is one that was tested.

    Raises:
        CompilerError: numba is missing, not one that was tested, or cannot be imported.
    """
    try:
        yield
    except (GranularError, MemoryError):
        raise
    except Exception as error:
        if isinstance(error, ImportError) or not _is_tested():
            raise CompilerError(error) from error
        raise


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
