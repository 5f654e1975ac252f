"""Compile kernels with numba, cache the programs made of them, report errors in short."""

import gc
import logging
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FunctionType
from typing import Any, Self

from numba import cfunc, njit, types
from numba.core import config, event
from numba.extending import typeof_impl

from mjgranular.errors import GranularError, InputError
from mjgranular.kernel import cache
from mjgranular.kernel.digest import build, digest, names_in_closure, stable_name
from mjgranular.kernel.threads import PROGRAMS, cancellation_point, uninterrupted

_logger = logging.getLogger(__name__)

_OPTIONS: dict[str, Any] = {
    # IEEE arithmetic (no fastmath): both interfaces and all platforms give the same numbers.
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}


class Kernel:
    """A function that kernels call, compiled at first use.

    It can be called from Python too, and is then compiled once more: the wrapper for such calls
    takes a fifth of the time to compile a program, and most kernels are never called so.
    """

    def __init__(self, py_func: FunctionType, dispatcher: Any) -> None:
        self.py_func, self.dispatcher = py_func, dispatcher
        self.targetoptions = getattr(dispatcher, "targetoptions", {})  # numba reads `inline` here
        self._from_python: Any = None

    def __call__(self, *args: Any) -> Any:
        if self._from_python is None:
            self._from_python = njit(self.py_func, **_OPTIONS)
        return self._from_python(*args)


def check_compiled(what: str, value: Any) -> None:
    """Check that a function of a custom law or surface is a kernel."""
    if not isinstance(value, Kernel):
        name = getattr(value, "__qualname__", value)
        raise InputError(f"{what} must be compiled, by mjgranular.kernel.compiled, got {name}")


@typeof_impl.register(Kernel)
def _type_of(kernel: Kernel, context: Any) -> Any:
    return types.Dispatcher(kernel.dispatcher)


def compiled(function: Callable[..., Any], *, inline: bool = False, merge: bool = False) -> Kernel:
    """Compile `function` in nopython mode at first use: a kernel, called like `function`.

    It may have scalar arithmetic and loops over arrays, without Python objects, exceptions or new
    arrays, and kernels in its closure. Programs are cached on disk (`entry`, `program_address`).

    `inline` is for small functions in loops over elements, and for those that pass on many numbers;
    it costs compile time. `merge`, for a large function with one caller, saves compile time.
    """
    made_of = names_in_closure(function)
    # numba names machine code by this and by a counter that starts over in every process: without
    # it, code of two kernels from one factory, loaded from the cache, would count as the same.
    name = f"{function.__module__}.{function.__qualname__}"
    bare = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    bare.__qualname__ = f"{name}_{digest(made_of)}" if made_of else name
    bare.__doc__ = function.__doc__
    # numba imports the module of a kernel; if the main thread is importing that module while it
    # waits for the compiling thread, neither would end.
    bare.__module__ = __name__
    only_from_kernels: dict[str, Any] = {"forceinline": inline, "no_cpython_wrapper": True}
    if merge:
        only_from_kernels["inline"] = "always"
    return Kernel(bare, njit(bare, **_OPTIONS, **only_from_kernels))


def entry(kernel: Any, signature: str) -> Callable[..., Any]:
    """Compile a kernel for calls from Python, for exactly these types, unless already compiled.

    Calling the result skips numba's choice among signatures, half the cost of a call from Python.
    """
    return _find(kernel, signature, _python_function)


def program_address(kernel: Any, signature: str, what: str = "") -> int:
    """Compile a kernel for calls from C, unless already compiled, and return its address."""
    return _find(kernel, signature, _c_function, what).address


def program_addresses(*programs: tuple[Any, str, str]) -> list[int]:
    """Return the addresses of programs, from arguments of `program_address`; 0 where it is None.

    Of several to be compiled, a second process compiles those whose kernels have a name in a
    module: half the time, if there are two processors.
    """
    missing = [program for program in programs if program[0] and not _is_known(*program)]
    named = [program for program in missing if "<" not in program[0].py_func.__qualname__]
    if named and len(missing) > len(named) and cache.HAS_LOCKS and cache.can_save():
        _compile_beside(named)
    addresses = [program_address(*program) if program[0] else 0 for program in programs]
    if missing:
        for process in _beside:
            with suppress(subprocess.TimeoutExpired):
                process.wait(1.0)  # it has saved its programs and ends
    return addresses


def _is_known(kernel: Any, signature: str, what: str) -> bool:
    key = (kernel, signature, _c_function)
    return key in _programs or cache.has(build(), _name_of(*key))


def _compile_beside(programs: list[tuple[Any, str, str]]) -> None:
    """Compile programs in another process; whoever asks for one waits for it (`cache.alone`)."""
    lines = [f"import sys; sys.path[:] = {sys.path!r}", f"from {__name__} import program_address"]
    for kernel, signature, _ in programs:
        module, _, name = kernel.py_func.__qualname__.rpartition(".")
        lines.append(f"from {module} import {name}; program_address({name}, {signature!r})")
    none = subprocess.DEVNULL
    with suppress(OSError, ValueError):  # no interpreter, or no process may be started
        started = [sys.executable, "-c", "\n".join(lines)]
        _beside.append(subprocess.Popen(started, stdin=none, stdout=none, stderr=none))


_beside: list[subprocess.Popen[bytes]] = []  # kept, since Python warns of one that is forgotten


def _python_function(function: Any, signature: str, keep: bool) -> Any:
    return njit(signature, cache=keep, **_OPTIONS)(function).get_overload(signature)


def _c_function(function: Any, signature: str, keep: bool) -> Any:
    return cfunc(signature, cache=keep, error_model="numpy")(function)


_programs: dict[tuple[Any, str, Any], Any] = {}


def _find(kernel: Any, signature: str, make: Callable[..., Any], what: str = "") -> Any:
    key = (kernel, signature, make)
    found = _programs.get(key)
    return uninterrupted(lambda: _find_or_make(key, what)) if found is None else found


def _find_or_make(key: tuple[Any, str, Any], what: str) -> Any:
    settings: Any = config
    if settings.DISABLE_JIT:
        raise InputError("sand has to be compiled: unset NUMBA_DISABLE_JIT")
    with PROGRAMS:
        found = _programs.get(key)
        if found is None:
            progress = event.install_listener("numba:compile", _Progress())
            with compiling(what), progress, _without_collections():
                found = _programs[key] = _load_or_compile(*key, what)
        return found


@contextmanager
def _without_collections() -> Iterator[None]:
    """Do not collect garbage: that takes a tenth of the time of compilation."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def _load_or_compile(kernel: Any, signature: str, make: Callable[..., Any], what: str) -> Any:
    name = _name_of(kernel, signature, make)

    def decorate(keep: bool = True) -> Any:
        return make(_call_of(kernel), signature, keep)

    found = cache.load(build(), name, decorate)
    if found is None:
        report_compiling(ONCE if cache.can_save() else ALWAYS, what)
        with cache.alone(build(), name):
            found = cache.load(build(), name, decorate) or cache.save(build(), name, decorate)
    return decorate(keep=False) if found is None else found


def _name_of(kernel: Any, signature: str, make: Callable[..., Any]) -> str:
    return digest((stable_name(kernel), signature, make.__name__))


# numba's cache names a function by its closure, whose name differs in every process, and by its
# file, which a function in a notebook does not have.
kernel: Any = None
_CALLS: Any = (
    lambda a: kernel(a),
    lambda a, b: kernel(a, b),
    lambda a, b, c: kernel(a, b, c),
    lambda a, b, c, d: kernel(a, b, c, d),
    lambda a, b, c, d, e: kernel(a, b, c, d, e),
    lambda a, b, c, d, e, f: kernel(a, b, c, d, e, f),
)


def _call_of(kernel: Any) -> Any:
    """Make a function that calls a kernel, merged into it, and has its name."""
    function = kernel.py_func
    call = _CALLS[function.__code__.co_argcount - 1]
    merged = njit(function, inline="always", **_OPTIONS)
    made = FunctionType(call.__code__, {"kernel": merged}, function.__name__)
    made.__qualname__ = f"{function.__qualname__}.call"
    made.__module__ = __name__
    return made


class _Progress(event.Listener):
    """Report what is compiled; between two kernels compilation can be cancelled."""

    def on_start(self, event: Any) -> None:
        cancellation_point()
        name = event.data["dispatcher"].py_func.__qualname__
        _logger.info("compiling %s", name.removesuffix(".call"))

    def on_end(self, event: Any) -> None:
        pass


# Errors of compilation that are short, and reports of compilation.


class KernelError(GranularError, TypeError):
    """A kernel cannot be compiled, most likely one of a custom law or surface.

    numba's long message is its cause.
    """

    @classmethod
    def of(cls, error: BaseException, what: str) -> Self:
        """Return the short one of an error of numba; `what` was to be compiled."""
        lines = [_COLORS.sub("", line).strip() for line in str(error).splitlines()]
        reason = next((line for line in lines if line and not line.startswith(_NO_REASON)), "")
        place = next(filter(None, map(_PLACE.search, lines)), None)
        where = f", in {place[1]}, line {place[2]}" if place else ""
        if isinstance(error, KeyError):  # numba names the attribute and nothing else
            reason = f"no record that they read has a field {reason}"
        return cls(
            f"numba cannot compile the kernels{what and ' for '}{what}: "
            f"{type(error).__name__}: {reason}{where}"
        )


_COLORS = re.compile(r"\x1b\[[0-9;]*m")  # of a terminal
_NO_REASON = "Failed in nopython mode pipeline"
_PLACE = re.compile(r'File "([^"]+)", line (\d+)')


@contextmanager
def compiling(what: str = "") -> Iterator[None]:
    """Turn errors of numba into a short one that says what failed and where."""
    try:
        yield
    except (GranularError, MemoryError):
        raise
    except Exception as error:
        raise KernelError.of(error, what) from error


ONCE = "once on a machine, up to a minute"
ALWAYS = "in every process, as no folder for compiled kernels can be written (see NUMBA_CACHE_DIR)"

_reported = False


def report_compiling(how_often: str, what: str) -> None:
    """Report that kernels are compiled now: each program of a sand, and the rest once.

    The report goes to the log, which the command line shows; else it is printed to a terminal.
    """
    global _reported
    if what:
        _logger.info("compiling for %s: %s", what, how_often, extra={"sand": what})
    new, _reported = bool(what) or not _reported, True
    if new and not (_logger.isEnabledFor(logging.INFO) and _logger.hasHandlers()):
        # A program without a console has no stderr, and a closed one cannot be queried.
        with suppress(AttributeError, OSError, ValueError):
            if sys.stderr.isatty():
                kernels = f"for {what}" if what else "kernels"
                print(f"mjgranular: compiling {kernels}: {how_often}", file=sys.stderr)
