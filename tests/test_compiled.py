"""Kernels kept on disk: what one process compiled is what another loads."""

import contextlib
import os
import subprocess
import sys

import mujoco
import pytest

from mjgranular import Plane, media
from mjgranular.kernel.compiled import _identity
from mjgranular.law.law import get_law, make_scene
from mjgranular.scheme.scheme import get_scheme

KERNELS = """
import math, sys, time
from pathlib import Path
from mjgranular.kernel import compiled

@compiled
def twice(x):
    return 2.0 * x

@compiled
def thrice(x):
    return 3.0 * x

def made_of(inner):
    @compiled
    def middle(x):  # too long to be inlined
        y = 0.0
BODY
        return inner(x) + 0.0 * y

    @compiled
    def outer(x):
        return middle(x) * middle(x + 1.0) / middle(x + 1.0)

    return outer

INNER = {"2": twice, "3": thrice}

def call(names):
    print(*[made_of(INNER[name])(1.0) for name in names])
"""

# One process stands still between the two halves of saving what it compiled, the index and the
# code, while the other saves all of its own.
RACE = """
from numba.core.caching import IndexDataCacheFile as Cache
me, other = sys.argv[1:]
load, save_index = Cache._load_index, Cache._save_index

def say(what):
    Path(f"{me}-{what}").touch()

def wait(what):
    end = time.monotonic() + 10
    while not Path(f"{other}-{what}").exists() and time.monotonic() < end:
        time.sleep(0.01)

def slow_load(self):
    found = load(self)
    if "outer" in self._index_name and sys._getframe(1).f_code.co_name == "save":
        say("loaded")
        wait("loaded" if me == "2" else "indexed")
    return found

def slow_index(self, overloads):
    save_index(self, overloads)
    if "outer" in self._index_name:
        say("indexed")
        if me == "2":
            wait("done")

Cache._load_index, Cache._save_index = slow_load, slow_index
call(me)
say("done")
"""


@pytest.fixture
def start(tmp_path):
    body = "".join(f"        y += math.sin(x + {i}) * math.exp(y)\n" for i in range(100))
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", body), encoding="utf-8")

    def start(code, *arguments):
        return subprocess.Popen(
            [sys.executable, "-c", f"from kernels import *\n{code}", *arguments],
            cwd=tmp_path,
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
                "PYTHONPATH": str(tmp_path),
            },
            stdout=subprocess.PIPE,
            text=True,
        )

    return start


def finish(process):
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    return out.split()


@pytest.mark.slow
def test_kernels_of_one_factory_from_two_processes(start):
    finish(start("twice(1.0), thrice(1.0)"))
    assert finish(start("call('2')")) == ["2.0"]
    assert finish(start("call('3')")) == ["3.0"]
    for order in ("23", "32"):
        assert finish(start(f"call('{order}')")) == [f"{name}.0" for name in order]


@pytest.mark.slow
def test_two_processes_compile_at_once(start):
    finish(start("twice(1.0), thrice(1.0)"))
    both = start(RACE, "2", "3"), start(RACE, "3", "2")
    assert [finish(process) for process in both] == [["2.0"], ["3.0"]]
    assert [finish(start(f"call('{name}')")) for name in "23"] == [["2.0"], ["3.0"]]


@pytest.mark.slow
def test_a_kernel_is_loaded_not_compiled_again(start):
    # numba counts what came from the cache and what did not.
    code = "made = made_of(twice); made(1.0); s = made.stats; print(*map(len, s[1:3]))"
    compiled_anew = finish(start(code))
    loaded = finish(start(code))
    assert compiled_anew == ["0", "1"]
    assert loaded == ["1", "0"]
    another = f"import mujoco; mujoco.__version__ = '9.9'; {code}"
    assert finish(start(another)) == ["0", "1"]


def seen_on_a_terminal(folder, code):
    """What a process writes to a terminal in place of standard error."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(folder)}
    done = subprocess.run([sys.executable, "-c", code], env=env, stderr=theirs, timeout=120)
    os.close(theirs)
    text = b""
    with contextlib.suppress(OSError):  # by which Linux tells the end
        while part := os.read(ours, 4096):
            text += part
    os.close(ours)
    assert done.returncode == 0, text.decode()
    return text.decode().splitlines()


def test_who_waits_at_a_terminal_is_told_once(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", ""), encoding="utf-8")
    code = "from kernels import *; twice(1.0); thrice(1.0); import sys; print('.', file=sys.stderr)"
    first, second = seen_on_a_terminal(tmp_path, code), seen_on_a_terminal(tmp_path, code)
    assert first == ["mjgranular: compiling kernels: once on a machine, up to half a minute", "."]
    assert second == ["."]
    reads_the_log = (
        "import logging; logging.basicConfig(level='INFO', format='%(message)s')\n"
        f"{code.replace('twice(1.0)', 'twice(1)')}"
    )
    lines = seen_on_a_terminal(tmp_path, reads_the_log)
    assert "compiling kernels.twice" in lines
    assert not any(line.startswith("mjgranular") for line in lines)


def test_who_does_not_look_is_not_told(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", ""), encoding="utf-8")
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    code = "from kernels import *; twice(1.0)"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_without_a_folder_to_write_to_it_says_so_in_every_process(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", ""), encoding="utf-8")
    code = (
        "from numba.core import caching; caching.CacheImpl._locator_classes = []\n"
        "from kernels import *; assert twice(1.0) == 2.0"
    )
    for _ in range(2):
        (line,) = seen_on_a_terminal(tmp_path, code)
        assert "in every process" in line
        assert "NUMBA_CACHE_DIR" in line


@pytest.mark.parametrize("law", ["link", "link_distributed", "rft2d", "rft3d", "depth_velocity"])
@pytest.mark.parametrize("scheme", ["explicit", "implicit"])
def test_programs_have_the_same_name_in_every_process(law, scheme):
    # What is told by its address is compiled anew in each.
    known_by = law.removesuffix("_distributed")
    medium = next(medium for medium in media.values() if known_by in medium.constants)
    law = get_law(law, medium)
    surface, model = Plane(), mujoco.MjModel.from_xml_string("<mujoco/>")
    scene = make_scene(law, medium, surface, model)
    program = get_scheme(scheme).program(law.kernel(surface), scene.dtype)
    assert " at 0x" not in repr(_identity(program))
