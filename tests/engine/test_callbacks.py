"""What MuJoCo calls: nothing that goes wrong there is lost, and no model runs without its sand."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import pytest

from mjgranular import Bed, DepthVelocityLaw, GranularError, add_sand
from mjgranular.engine import plugin, trampolines
from mjgranular.kernel.threads import cancellation_point, run_in_worker

LAW = DepthVelocityLaw(stiffness=100, linear=5)

BALL = """
<mujoco>
  <worldbody>
    <geom name="tray" type="box" size="1 1 .5" pos="0 0 -.5" contype="0" conaffinity="0"/>
    <body pos="0 0 -.02"><freejoint/><geom type="sphere" size=".05"/></body>
  </worldbody>
</mujoco>
"""


def sandy_ball() -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_string(BALL)
    add_sand(spec, law=LAW, surface=Bed("tray"))
    return spec.compile()


@pytest.fixture
def loader() -> Any:
    """The loader of the engine, activated."""
    mujoco.MjData(sandy_ball())
    return plugin._engine._loader


@pytest.fixture
def sigint() -> Iterator[None]:
    """SIGINT as Python takes it, also in a process that was begun in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def raising(error: BaseException) -> Any:
    def load(*arguments: Any, **options: Any) -> None:
        raise error

    return load


class Late(BaseException):
    """What a signal's handler of somebody's own may raise."""


@pytest.mark.parametrize("error", [KeyboardInterrupt("now"), SystemExit(3), Late("too", "late")])
def test_what_interrupts_is_raised_when_mujoco_has_returned(
    loader: Any, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    model = sandy_ball()
    kept: list[mujoco.MjData] = []
    with monkeypatch.context() as patch:
        patch.setattr(loader, "load", raising(error))
        with pytest.raises(type(error)) as caught:
            mujoco.MjData(model)
        assert caught.value is error
        with pytest.raises(type(error)) as caught:
            sandy_ball()
        assert caught.value is error
        with pytest.raises(type(error)):  # nothing of Python's runs between making and keeping
            kept.extend(map(mujoco.MjData, [model]))
    for data in kept:
        with pytest.raises(mujoco.FatalError, match="was not prepared"):
            mujoco.mj_step(model, data)
    assert len(kept) == 1
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert data.qfrc_passive.any()


def test_an_interrupt_before_the_first_line_is_raised(
    loader: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python gives no answer then: here because its function takes other arguments."""
    model = sandy_ball()
    with monkeypatch.context() as patch:
        patch.setattr(
            trampolines.Answer, "from_address", raising(KeyboardInterrupt()), raising=False
        )
        for make in (lambda: mujoco.MjData(model), sandy_ball):
            with pytest.raises(KeyboardInterrupt):
                make()
    mujoco.mj_step(model, mujoco.MjData(model))


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "MemoryError"),
        (GranularError("half\0%s%n"), r"half\\x00%s%n"),
        (GranularError("sand" + 600 * "\N{EURO SIGN}"), "\N{EURO SIGN}...$"),
        (GranularError("sand \udcff"), r"sand \\udcff"),
    ],
)
def test_what_goes_wrong_is_an_error_of_mujocos(
    loader: Any, monkeypatch: pytest.MonkeyPatch, error: Exception, said: str
) -> None:
    model = sandy_ball()
    with monkeypatch.context() as patch:
        patch.setattr(loader, "load", raising(error))
        with pytest.raises(mujoco.FatalError, match=said):
            mujoco.MjData(model)
        with pytest.raises(ValueError, match=said):
            sandy_ball()
        patch.setattr(plugin, "instance_name", raising(MemoryError()))
        with pytest.raises(mujoco.FatalError, match="preparing sand failed"):
            mujoco.MjData(model)
    mujoco.mj_step(model, mujoco.MjData(model))


def test_an_interrupt_of_another_thread_is_an_error(
    loader: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = sandy_ball()
    said = []

    def make() -> None:
        try:
            mujoco.MjData(model)
        except mujoco.FatalError as error:
            said.append(str(error))

    monkeypatch.setattr(loader, "load", raising(KeyboardInterrupt()))
    thread = threading.Thread(target=make)
    thread.start()
    thread.join()
    assert "KeyboardInterrupt" in said[0]


NOT_UTF8 = b"""
<mujoco>
  <extension>
    <plugin plugin="mjgranular.sand">
      <instance name="s\xe4nd%s%n">
        <config key="law" value="depth_velocity stiffness=100 linear=5"/>CONFIG
      </instance>
    </plugin>
    <plugin plugin="mjgranular.sensor"/>
  </extension>
  <worldbody>
    <body name="b\xe4ll" pos="0 0 -.02"><freejoint/><geom name="b\xe4ll" size=".05"/></body>
  </worldbody>
  <sensor>
    <plugin name="dr\xe4g" plugin="mjgranular.sensor">
      <config key="measure" value="MEASURE"/>
    </plugin>
  </sensor>
</mujoco>
"""


def test_names_that_are_not_utf8(tmp_path: Path) -> None:
    def load(config: bytes = b"", measure: bytes = b"force") -> mujoco.MjModel:
        path = tmp_path / "model.xml"
        path.write_bytes(NOT_UTF8.replace(b"CONFIG", config).replace(b"MEASURE", measure))
        return mujoco.MjModel.from_xml_path(str(path))

    # The name is shown, not taken for a format; where Python's bindings read it they would raise.
    for config, measure in (
        (b"", b"force"),
        (b"", b"p\xf6wer"),
        (b'<config key="bodies" value="b\xe4ll%d"/>', b"force"),
    ):
        with pytest.raises(ValueError, match=r"mjgranular 's\\+xe4nd%s%n': a name .* not UTF-8"):
            load(config, measure)
    with pytest.raises(ValueError, match=r"config 'surface'.*no surface 'b\\*xe4d'"):
        load(config=b'<config key="surface" value="b\xe4d"/>')


def blocks(loader: Any) -> int:
    """How many instances have a block."""
    gc.collect()
    return len(loader._handles)


@pytest.mark.slow
def test_the_same_bed_made_again_and_again_is_prepared_once(loader: Any) -> None:
    before = blocks(loader)
    loader._prepared.clear()
    for _ in range(6):
        model = sandy_ball()
        kept = [mujoco.MjData(model) for _ in range(3)]
        assert blocks(loader) == before + 3
        assert len(loader._prepared) < 5  # with contacts of the tray, without, ...
        del kept
    assert blocks(loader) == before


@pytest.mark.slow
def test_a_load_that_fails_leaves_nothing(loader: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from mjgranular.engine import block

    before = blocks(loader)
    spec = mujoco.MjSpec.from_string(BALL)
    add_sand(spec, name="good", law=LAW)
    add_sand(spec, name="bad", law=LAW)
    spec.plugins[1].config = {**spec.plugins[1].config, "surface": "plane height=nan"}
    for _ in range(3):
        with pytest.raises(ValueError, match="finite"):
            spec.compile()
    assert blocks(loader) <= before
    monkeypatch.setattr(block, "bind", raising(MemoryError()))
    spec.plugins[1].config = {**spec.plugins[1].config, "surface": "plane height=0.125"}
    with pytest.raises(ValueError, match="MemoryError"):
        spec.compile()
    monkeypatch.undo()
    spec.plugins[1].config = {**spec.plugins[1].config, "tunable": "true"}
    mujoco.MjData(spec.compile())  # and the next time it is made


# As if every program took a while to compile: the first model again, at each moment in turn.
INTERRUPTED = """
import pickle, signal, sys, threading, time
import mujoco, mjgranular
from mjgranular.engine import plugin
from mjgranular.kernel.threads import cancellation_point

compiled = sys.modules["mjgranular.kernel.compiled"]
LAW = mjgranular.DepthVelocityLaw(stiffness=100, linear=5)

class Slow(dict):
    def get(self, key):
        if threading.current_thread() is threading.main_thread():
            return None
        for _ in range(5):
            cancellation_point()
            time.sleep(0.002)
        return super().get(key)

def spec():
    made = mujoco.MjSpec.from_string(BALL)
    for i in range(200):
        made.worldbody.add_geom(size=[0.1, 0, 0], pos=[9, 9, i])
    mjgranular.add_sand(made, law=LAW)
    return made

def step(model, data):
    assert data is not None
    mujoco.mj_step(model, data, 5)
    assert data.qfrc_passive.any(), "a model ran without its sand"

model = spec().compile()
data = mujoco.MjData(model)
pickled = pickle.dumps(model), pickle.dumps(data)
compiled._programs = Slow(compiled._programs)
signal.signal(signal.SIGALRM, signal.default_int_handler)

def attempt(way):
    if way == "spec":
        made = spec().compile()
        return made, mujoco.MjData(made)
    if way == "model":
        made = pickle.loads(pickled[0])
        return made, mujoco.MjData(made)
    if way == "data":
        made = pickle.loads(pickled[1])
        return made.model, made
    mjgranular.Sand(mujoco.MjSpec.from_string(BALL).compile(), law=LAW)
    return None

for way in ("spec", "model", "data", "sand"):
    counts = [0, 0]
    for moment in range(MOMENTS):
        plugin._engine._active.clear()
        plugin._engine._loader._prepared.clear()
        for again in (False, True):
            made = None
            try:
                try:
                    if not again:
                        signal.setitimer(signal.ITIMER_REAL, 1e-5 + SPAN * (moment / MOMENTS) ** 2)
                    made = attempt(way)
                    counts[again] += 1
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
            except KeyboardInterrupt:
                pass
            if made:
                step(*made)
    assert counts[1] == MOMENTS
    print(way, MOMENTS - counts[0], "of", MOMENTS)
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a timer that sends signals")
def test_an_interrupt_at_any_moment_is_raised_and_leaves_nothing_half_made() -> None:
    code = INTERRUPTED.replace("BALL", repr(BALL)).replace("MOMENTS", "12").replace("SPAN", "0.08")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    for line in done.stdout.splitlines():
        interrupted = int(line.split()[1])
        assert interrupted >= 4, done.stdout
    assert len(done.stdout.splitlines()) == 4


COLD = """
import signal, time
import mujoco, mjgranular
trying = early = False

def interrupt(*_):
    global early
    if trying:
        raise KeyboardInterrupt
    early = True  # on a busy machine: raised by the next attempt

signal.signal(signal.SIGINT, interrupt)
spec = mujoco.MjSpec.from_string(BALL)
law = mjgranular.DepthVelocityLaw(stiffness=100, linear=5)
mjgranular.add_sand(spec, law=law, scheme="explicit")
print("compiling", flush=True)
interrupts = 0
while True:
    try:
        trying = True
        if early:
            raise KeyboardInterrupt
        model = spec.compile()
        data = mujoco.MjData(model)
        break
    except KeyboardInterrupt:
        trying = early = False
        interrupts += 1
        print("interrupted", flush=True)
data.qvel[2] = -1.0
mujoco.mj_step(model, data)
assert data.qfrc_passive.any()
print(interrupts)
"""


WAITS = (0.01, 0.1, 0.3, 0.7, 0.05)


@pytest.mark.slow
def test_a_compiler_that_is_interrupted_compiles_later(tmp_path: Path) -> None:
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", COLD.replace("BALL", repr(BALL))]
    with subprocess.Popen(
        command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "compiling\n"
        for wait in WAITS:
            time.sleep(wait)
            process.send_signal(2)
            assert process.stdout.readline() == "interrupted\n"
        out, err = process.communicate(timeout=600)
    assert process.returncode == 0, err
    assert out == f"{len(WAITS)}\n"


def test_work_in_a_worker_thread_is_waited_for_and_can_be_cancelled(sigint: None) -> None:
    main = threading.main_thread().ident
    seen = []

    def work() -> None:
        ctypes.pythonapi.PyErr_SetInterrupt()
        try:
            for _ in range(2000):
                time.sleep(0.001)
                cancellation_point()
        except KeyboardInterrupt:
            time.sleep(0.02)
            seen.append(threading.get_ident())
            raise

    with pytest.raises(KeyboardInterrupt):
        run_in_worker(work)
    assert len(seen) == 1
    assert seen[0] != main
    cancellation_point()
    assert run_in_worker(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        run_in_worker(lambda: 1 // 0)


FORKED = """
import os, threading, time
import mujoco, numba, mjgranular
from mjgranular import DepthVelocityLaw, Plane

def load(height):
    spec = mujoco.MjSpec.from_string(BALL)
    law = DepthVelocityLaw(stiffness=100, linear=5)
    mjgranular.add_sand(spec, law=law, surface=Plane(height=height))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    assert data.qfrc_passive.any()

load(0.0)
done = []

def busy():
    k = 1
    while not done:
        WORK
        k += 1

thread = threading.Thread(target=busy)
thread.start()
time.sleep(0.1)
for k in range(8):
    child = os.fork()
    if child == 0:
        load(0.01)
        os._exit(7)
    end = time.monotonic() + 300
    while True:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            break
        if time.monotonic() > end:
            os.kill(child, 9)
            print("hangs", flush=True)
            os._exit(1)
        time.sleep(0.002)
    assert os.waitstatus_to_exitcode(status) == 7
done.append(True)
thread.join()
print("all")
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="has no fork")
@pytest.mark.parametrize(
    "work",
    ["load(k * 1e-4)", "numba.njit('float64(float64)')(lambda x: x + k)"],
    ids=["loads sand", "compiles a user's function"],
)
def test_a_fork_while_another_thread_works(work: str) -> None:
    code = f"import warnings; warnings.simplefilter('ignore')\n{FORKED.replace('WORK', work)}"
    command = [sys.executable, "-c", code.replace("BALL", repr(BALL))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout == "all\n"
