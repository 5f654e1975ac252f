"""Trampolines: a few machine instructions each, between MuJoCo and Python.

A Python function that MuJoCo called directly could fail before its first line, if a signal has
arrived; MuJoCo would then read a random result. Trampolines have Python write its answer to
separate memory. Without an answer the sand is not prepared, and a step is an error of MuJoCo.
Messages are passed as strings, never as formats. What needs no Python, such as the number of values
of an instance, is computed without it.

An interrupt is not an error of MuJoCo: Python would raise that error first, and the interrupt
somewhere in its handler. So `init` returns success, the rest of MuJoCo's call runs without sand,
and the interrupt is raised as soon as it returns. From then on that `mjData`, if it is still used,
counts as one whose sand is not prepared.
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

from mjgranular.engine.library import library
from mjgranular.kernel.machine import load_functions, publish, publish_functions

FAIL = "mjgranular_fail"
"""Name of `fail(text)`: raise an error of MuJoCo; does not return."""

UNPREPARED = "mjgranular_unprepared"
"""Name of `unprepared(data)`: raise an error of MuJoCo that the sand is not prepared; returns only
if `pausing` allows it."""

FORGET = "mjgranular_forget"
"""Name of `forget(data)`, called when an `mjData` is freed: another may get its address."""

pausing = ctypes.c_int64(0)
"""Address of the `mjData` that runs without sand, 0 for none: while an interrupt is pending, and
while the layout of MuJoCo's memory is determined."""

_PYTHON = (
    "PyGILState_Ensure",
    "PyGILState_Release",
    "PyObject_CallFunction",
    "Py_DecRef",
    "PyErr_Clear",
    "PyErr_SetInterrupt",
    "PyThread_get_thread_ident",
)

FINE, ERROR, INTERRUPT = 1, 2, 3
"""Answers of Python: an error comes with the address of a message. 0 is no answer."""

Answer = ctypes.c_int64 * 2
"""Answer of Python at the address that it gets: one of these, and its message."""

_COMMON = r"""
@says = private constant [3 x i8] c"%s\00"
@why = private constant [WHY]

declare void @mju_error(ptr, ...)

define void @mjgranular_fail(i64 %text) {
  %pointer = inttoptr i64 %text to ptr
  call void (ptr, ...) @mju_error(ptr @says, ptr %pointer)
  ret void
}

define void @mjgranular_unprepared(i64 %data) {
  %cell = inttoptr i64 PAUSING to ptr
  %pausing = load volatile i64, ptr %cell
  %meant = icmp eq i64 %pausing, %data
  br i1 %meant, label %leave, label %tell
tell:
  call void (ptr, ...) @mju_error(ptr @says, ptr @why)
  br label %leave
leave:
  ret void
}

define void @mjgranular_compute(i64 %model, i64 %data, i32 %instance, i32 %capability) {
  call void @mjgranular_unprepared(i64 %data)
  ret void
}

define void @mjgranular_forget(i64 %data) {
  %cell = inttoptr i64 PAUSING to ptr
  %pausing = load volatile i64, ptr %cell
  %gone = icmp eq i64 %pausing, %data
  br i1 %gone, label %forget, label %leave
forget:
  store volatile i64 0, ptr %cell
  br label %leave
leave:
  ret void
}

define void @mjgranular_destroy(i64 %data, i32 %instance) {
  call void @mjgranular_forget(i64 %data)
  ret void
}

define void @mjgranular_reset(i64 %model, i64 %state, i64 %handle, i32 %instance) {
  ret void
}

define i1 @mjgranular_equal(ptr %a, ptr %b) {
begin:
  br label %next
next:
  %i = phi i64 [0, %begin], [%j, %more]
  %p = getelementptr i8, ptr %a, i64 %i
  %q = getelementptr i8, ptr %b, i64 %i
  %x = load i8, ptr %p
  %y = load i8, ptr %q
  %same = icmp eq i8 %x, %y
  br i1 %same, label %more, label %no
more:
  %j = add i64 %i, 1
  %end = icmp eq i8 %x, 0
  br i1 %end, label %yes, label %next
yes:
  ret i1 true
no:
  ret i1 false
}
"""

_INIT = r"""
@format = private constant [5 x i8] c"LLiL\00"
@format_of_place = private constant [2 x i8] c"L\00"

declare i32 @PyGILState_Ensure()
declare void @PyGILState_Release(i32)
declare ptr @PyObject_CallFunction(ptr, ptr, ...)
declare void @Py_DecRef(ptr)
declare void @PyErr_Clear()
declare void @PyErr_SetInterrupt()
declare i64 @PyThread_get_thread_ident()
declare void @mjgranular_fail(i64)

define i32 @NAME_init(i64 %model, i64 %data, i32 %instance) {
  %answer = alloca [2 x i64]
  store volatile i64 0, ptr %answer
  %second = getelementptr i64, ptr %answer, i64 1
  store volatile i64 0, ptr %second
  %place = ptrtoint ptr %answer to i64
  %function = inttoptr i64 FUNCTION to ptr
  %cell = inttoptr i64 PAUSING to ptr
  %pausing = load volatile i64, ptr %cell
  %due = icmp eq i64 %pausing, %data
  br i1 %due, label %leave, label %ask
ask:
  %held = call i32 @PyGILState_Ensure()
  %made = call ptr (ptr, ptr, ...) @PyObject_CallFunction(ptr %function, ptr @format,
    i64 %model, i64 %data, i32 %instance, i64 %place)
  %failed = icmp eq ptr %made, null
  br i1 %failed, label %lost, label %returned
lost:
  call void @PyErr_Clear()
  br label %answered
returned:
  call void @Py_DecRef(ptr %made)
  br label %answered
answered:
  %said = load volatile i64, ptr %answer
  %with = load volatile i64, ptr %second
  %thread = call i64 @PyThread_get_thread_ident()
  %main = icmp eq i64 %thread, MAIN
  switch i64 %said, label %done [
    i64 0, label %silent
    i64 INTERRUPT, label %interrupted
  ]
silent:
  br i1 %main, label %again, label %done
again:
  %noticing = inttoptr i64 NOTICE to ptr
  %noticed = call ptr (ptr, ptr, ...) @PyObject_CallFunction(ptr %noticing, ptr @format_of_place,
    i64 %place)
  %lost_again = icmp eq ptr %noticed, null
  br i1 %lost_again, label %clear, label %release
clear:
  call void @PyErr_Clear()
  br label %look
release:
  call void @Py_DecRef(ptr %noticed)
  br label %look
look:
  %then = load volatile i64, ptr %answer
  %notice = icmp eq i64 %then, INTERRUPT
  br i1 %notice, label %interrupted, label %signal
interrupted:
  store volatile i64 %data, ptr %cell
  br label %signal
signal:
  call void @PyErr_SetInterrupt()
  br label %done
done:
  call void @PyGILState_Release(i32 %held)
  %error = icmp eq i64 %said, ERROR
  br i1 %error, label %tell, label %leave
tell:
  call void @mjgranular_fail(i64 %with)
  br label %leave
leave:
  ret i32 0
}

declare ptr @mj_getPluginConfig(i64, i32, ptr)
declare i1 @mjgranular_equal(ptr, ptr)
"""

_COUNT = r"""
@format_of_count = private constant [4 x i8] c"LiL\00"

define i32 @NAME_nstate(i64 %model, i32 %instance) {
  %answer = alloca i64
  store volatile i64 0, ptr %answer
  %place = ptrtoint ptr %answer to i64
  %function = inttoptr i64 FUNCTION to ptr
  %held = call i32 @PyGILState_Ensure()
  %made = call ptr (ptr, ptr, ...) @PyObject_CallFunction(ptr %function, ptr @format_of_count,
    i64 %model, i32 %instance, i64 %place)
  %failed = icmp eq ptr %made, null
  br i1 %failed, label %lost, label %counted
lost:
  call void @PyErr_Clear()
  call void @PyErr_SetInterrupt()
  br label %leave
counted:
  call void @Py_DecRef(ptr %made)
  br label %leave
leave:
  call void @PyGILState_Release(i32 %held)
  %number = load volatile i64, ptr %answer
  %size = trunc i64 %number to i32
  ret i32 %size
}
"""

_WHY = (
    "mjgranular: the sand of this mjData was not prepared, as that failed or was interrupted: "
    "make a new mjData"
)


@dataclass(frozen=True)
class Size:
    """Number of values of an instance, by its configuration.

    Attributes:
        key: key of the configuration.
        sizes: number by its value.
        otherwise: number for all other values, and for none.
    """

    key: str
    sizes: Mapping[str, int]
    otherwise: int


NONE = Size("", {}, 0)
"""No values, for any configuration."""


def raise_later(error: BaseException) -> None:
    """Have Python raise this at the next SIGINT, in the main thread, once.

    The trampoline triggers that when MuJoCo returns (`PyErr_SetInterrupt`).
    """
    previous = signal.getsignal(signal.SIGINT)

    def deliver(number: int, frame: object) -> None:
        # None for a handler that is not Python's.
        signal.signal(signal.SIGINT, previous or signal.default_int_handler)
        pausing.value = 0  # MuJoCo has returned
        raise error

    signal.signal(signal.SIGINT, deliver)


def _notice(place: int) -> None:
    """Handle an interrupt because of which Python gave no answer: a signal had arrived before."""
    ctypes.c_int64.from_address(place).value = INTERRUPT
    raise_later(KeyboardInterrupt())


def make_trampolines(
    name: str,
    init: Callable[[int, int, int, int], object],
    count_state: Callable[[int, int, int], object] | None,
    nsensordata: Size,
) -> dict[str, int]:
    """Make the functions of a plugin before any of it is compiled.

    Args:
        name: name of the plugin.
        init: `init(model, data, instance, answer)` writes at the address `answer` (`Answer`).
        count_state: `count_state(model, instance, place)` writes the size of its state at an
            address; None for no state.
        nsensordata: number of its readings.

    Returns:
        Addresses by the names of the fields of `mjpPlugin`.
    """
    common = _common()
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(init))  # it lives as long as the process
    name = name.replace(".", "_")
    code = _filled(
        _INIT,
        NAME=name,
        FUNCTION=id(init),
        PAUSING=ctypes.addressof(pausing),
        MAIN=threading.main_thread().ident,
        NOTICE=id(_notice),
        INTERRUPT=INTERRUPT,
        ERROR=ERROR,
    )
    if count_state is None:
        code += _size(name, "nstate", NONE, "")
    else:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(count_state))
        code += _filled(_COUNT, NAME=name, FUNCTION=id(count_state))
    code += _size(name, "nsensordata", nsensordata, ", i32")
    own = {f"{name}_{field}": field for field in ("init", "nstate", "nsensordata")}
    found = load_functions(code, own)
    return common | {own[name]: address for name, address in found.items()}


@cache
def _common() -> dict[str, int]:
    """Make the functions that all plugins share, registered for compiled code."""
    publish_functions(library(), ("mju_error", "mj_getPluginConfig"))
    publish_functions(ctypes.pythonapi, _PYTHON)
    code = _filled(_COMMON, PAUSING=ctypes.addressof(pausing)).replace("[WHY]", _text(_WHY))
    fields = {f"mjgranular_{field}": field for field in ("compute", "reset", "destroy")}
    for_kernels = (FAIL, UNPREPARED, FORGET, "mjgranular_equal")
    found = load_functions(code, (*fields, *for_kernels))
    for name in for_kernels:
        publish(name, found[name])
    return {field: found[name] for name, field in fields.items()}


def _size(name: str, field: str, size: Size, more: str) -> str:
    """Return the code of a function that returns a number."""
    cases = texts = ""
    for i, (value, number) in enumerate(size.sizes.items()):
        texts += f"@{field}_{i} = private constant {_text(value)}\n"
        cases += f"""case{i}:
  %is{i} = call i1 @mjgranular_equal(ptr %text, ptr @{field}_{i})
  br i1 %is{i}, label %found{i}, label %case{i + 1}
found{i}:
  ret i32 {number}
"""
    return f"""{texts}
@{field}_key = private constant {_text(size.key)}

define i32 @{name}_{field}(i64 %model, i32 %instance{more}) {{
  %text = call ptr @mj_getPluginConfig(i64 %model, i32 %instance, ptr @{field}_key)
  %none = icmp eq ptr %text, null
  br i1 %none, label %otherwise, label %case0
{cases}case{len(size.sizes)}:
  br label %otherwise
otherwise:
  ret i32 {size.otherwise}
}}
"""


def _filled(code: str, **words: object) -> str:
    for word, value in words.items():
        code = code.replace(word, str(value))
    return code


def _text(text: str) -> str:
    """Return a C string in LLVM syntax."""
    raw = text.encode() + b"\0"
    letters = "".join(f"\\{byte:02X}" for byte in raw)
    return f'[{len(raw)} x i8] c"{letters}"'
