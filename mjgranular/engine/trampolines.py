"""Trampolines: a few machine instructions each, between MuJoCo and Python.

A Python function that MuJoCo called directly could fail before its first line, if a signal has
arrived; MuJoCo would then read a random result. Trampolines have Python write its answer to
separate memory. Without an answer the sand is not prepared, and a step is an error of MuJoCo.
Messages are passed as strings, never as formats.

MuJoCo's compiler moves muscles, to find their range of length, with all forces disabled, in an
`mjData` without a call of `init`: there unprepared sand is not an error.
An interrupt is not an error of MuJoCo: Python would raise that error first, and the interrupt
somewhere in its handler. So `init` returns success, the rest of MuJoCo's call runs without sand,
and the interrupt is raised as soon as it returns. The sand of that `mjData` stays unprepared.
"""

import ctypes
import signal
import threading
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import mujoco

from mjgranular.kernel.engine import library, offset_of
from mjgranular.kernel.intrinsics import load_functions, publish, publish_functions
from mjgranular.kernel.records import NO_GRAVITY, NO_PASSIVE_FORCES

FAIL = "mjgranular_fail"
"""Name of `fail(text)`: raise an error of MuJoCo; does not return."""

UNPREPARED = "mjgranular_unprepared"
"""Name of the first `compute` of plugins: an error of MuJoCo, unless unprepared sand is meant."""

FORGET = "mjgranular_forget"
"""Name of the first `destroy`: when an `mjData` is freed, another may get its address."""

_ASK = "mjgranular_ask"  # calls a function of Python, and returns whether that has failed
_RESET = "mjgranular_reset"  # the first `reset`: there is nothing to do

pausing = ctypes.c_int64(0)
"""Address of the `mjData` that runs without sand while an interrupt is pending; 0 for none."""

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

Asked = Callable[[int, int, int, int], object]

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

define void @mjgranular_unprepared(ptr %model, i64 %data, i32 %instance, i32 %capability) {
  %pausing = load volatile i64, ptr inttoptr (i64 PAUSING to ptr)
  %meant = icmp eq i64 %pausing, %data
  %place = getelementptr i8, ptr %model, i64 DISABLED
  %flags = load i32, ptr %place
  %disabled = and i32 %flags, NO_FORCES
  %forceless = icmp eq i32 %disabled, NO_FORCES
  %fine = or i1 %meant, %forceless
  br i1 %fine, label %leave, label %raise
raise:
  call void (ptr, ...) @mju_error(ptr @says, ptr @why)
  br label %leave
leave:
  ret void
}

define void @mjgranular_forget(i64 %data, i32 %instance) {
  %pausing = load volatile i64, ptr inttoptr (i64 PAUSING to ptr)
  %gone = icmp eq i64 %pausing, %data
  br i1 %gone, label %forget, label %leave
forget:
  store volatile i64 0, ptr inttoptr (i64 PAUSING to ptr)
  br label %leave
leave:
  ret void
}

define void @mjgranular_reset(i64 %model, i64 %state, i64 %handle, i32 %instance) {
  ret void
}

@format = private constant [5 x i8] c"LLiL\00"

declare i32 @PyGILState_Ensure()
declare void @PyGILState_Release(i32)
declare ptr @PyObject_CallFunction(ptr, ptr, ...)
declare void @Py_DecRef(ptr)
declare void @PyErr_Clear()

define i1 @mjgranular_ask(ptr %function, i64 %model, i64 %data, i32 %instance, ptr %answer) {
  store volatile i64 0, ptr %answer
  %place = ptrtoint ptr %answer to i64
  %held = call i32 @PyGILState_Ensure()
  %made = call ptr (ptr, ptr, ...) @PyObject_CallFunction(
    ptr %function, ptr @format, i64 %model, i64 %data, i32 %instance, i64 %place)
  %failed = icmp eq ptr %made, null
  br i1 %failed, label %clear, label %release
clear:
  call void @PyErr_Clear()
  br label %leave
release:
  call void @Py_DecRef(ptr %made)
  br label %leave
leave:
  call void @PyGILState_Release(i32 %held)
  ret i1 %failed
}
"""

_INIT = r"""
declare void @PyErr_SetInterrupt()
declare i64 @PyThread_get_thread_ident()
declare void @mjgranular_fail(i64)
declare i1 @mjgranular_ask(ptr, i64, i64, i32, ptr)

define i32 @NAME_init(i64 %model, i64 %data, i32 %instance) {
  %answer = alloca [2 x i64]
  %second = getelementptr i64, ptr %answer, i64 1
  store volatile i64 0, ptr %second
  %pausing = load volatile i64, ptr inttoptr (i64 PAUSING to ptr)
  %due = icmp eq i64 %pausing, %data
  br i1 %due, label %leave, label %ask
ask:
  %failed = call i1 @mjgranular_ask(
    ptr inttoptr (i64 FUNCTION to ptr), i64 %model, i64 %data, i32 %instance, ptr %answer)
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
  %failed_again = call i1 @mjgranular_ask(
    ptr inttoptr (i64 NOTICE to ptr), i64 %model, i64 %data, i32 %instance, ptr %answer)
  %then = load volatile i64, ptr %answer
  %notice = icmp eq i64 %then, INTERRUPT
  br i1 %notice, label %interrupted, label %signal
interrupted:
  store volatile i64 %data, ptr inttoptr (i64 PAUSING to ptr)
  br label %signal
signal:
  call void @PyErr_SetInterrupt()
  br label %done
done:
  %error = icmp eq i64 %said, ERROR
  br i1 %error, label %raise, label %leave
raise:
  call void @mjgranular_fail(i64 %with)
  br label %leave
leave:
  ret i32 0
}
"""

_COUNT = r"""
define i32 @NAME_FIELD(i64 %model, i32 %instanceMORE) {
  %answer = alloca i64
  %failed = call i1 @mjgranular_ask(
    ptr inttoptr (i64 FUNCTION to ptr), i64 %model, i64 0, i32 %instance, ptr %answer)
  br i1 %failed, label %interrupt, label %leave
interrupt:
  call void @PyErr_SetInterrupt()
  br label %leave
leave:
  %number = load volatile i64, ptr %answer
  %size = trunc i64 %number to i32
  ret i32 %size
}
"""

_WHY = (
    "mjgranular: the sand of this mjData was not prepared, as that failed or was interrupted: "
    "make a new mjData"
)


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


def _notice(model: int, data: int, instance: int, place: int) -> None:
    """Handle an interrupt because of which Python gave no answer: a signal had arrived before."""
    ctypes.c_int64.from_address(place).value = INTERRUPT
    raise_later(KeyboardInterrupt())


def make_trampolines(name: str, init: Asked, counts: Mapping[str, Asked]) -> dict[str, int]:
    """Make the functions of a plugin, by the fields of `mjpPlugin`, before any of it is compiled.

    `init(model, data, instance, place)` writes its answer at an address (`Answer`). For `nstate`
    and `nsensordata`, `count(model, 0, instance, place)` writes the number of values there.
    """
    common, name = _common(), name.replace(".", "_")
    code = _filled(
        _INIT,
        NAME=name,
        FUNCTION=_immortal(init),
        PAUSING=ctypes.addressof(pausing),
        MAIN=threading.main_thread().ident,
        NOTICE=id(_notice),
        INTERRUPT=INTERRUPT,
        ERROR=ERROR,
    )
    for field, count in counts.items():
        more = ", i32 %sensor" if field == "nsensordata" else ""
        code += _filled(_COUNT, NAME=name, FIELD=field, FUNCTION=_immortal(count), MORE=more)
    fields = {f"{name}_{field}": field for field in ("init", *counts)}
    found = load_functions(code, fields)
    return common | {fields[name]: address for name, address in found.items()}


def _immortal(function: Any) -> int:
    """Return the address of a function, which lives as long as the process."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(function))
    return id(function)


@cache
def _common() -> dict[str, int]:
    """Make the functions that all plugins share, registered for compiled code."""
    publish_functions(library(), ["mju_error"])
    publish_functions(ctypes.pythonapi, _PYTHON)
    code = _filled(
        _COMMON,
        PAUSING=ctypes.addressof(pausing),
        DISABLED=offset_of("mjModel", "opt") + offset_of("mjOption", "disableflags"),
        NO_FORCES=NO_GRAVITY | NO_PASSIVE_FORCES | int(mujoco.mjtDisableBit.mjDSBL_ACTUATION),
    ).replace("[WHY]", _text(_WHY))
    found = load_functions(code, (FAIL, UNPREPARED, FORGET, _ASK, _RESET))
    for name, address in found.items():
        publish(name, address)
    return {"compute": found[UNPREPARED], "reset": found[_RESET], "destroy": found[FORGET]}


def _filled(code: str, **words: object) -> str:
    for word, value in words.items():
        code = code.replace(word, str(value))
    return code


def _text(text: str) -> str:
    """Return a C string in LLVM syntax."""
    raw = text.encode() + b"\0"
    letters = "".join(f"\\{byte:02X}" for byte in raw)
    return f'[{len(raw)} x i8] c"{letters}"'
