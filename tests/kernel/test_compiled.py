"""Kernels kept on disk: what one process compiled is what another loads."""

import contextlib
import os
import subprocess
import sys

import pytest

from mjgranular.kernel.compiled import compiled

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


PROGRAM = """
from mjgranular.kernel import entry

@compiled
def add(n, x):
    return n + int(twice(x))

def sum_of(n, x):
    seen = "numba" in sys.modules
    print(entry(add, "int64", "float64")(n, x), seen, "numba" in sys.modules)
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", "") + PROGRAM, encoding="utf-8")

    def run(code, cache="cache"):
        command = [sys.executable, "-c", f"from kernels import *\n{code}"]
        env = {
            **os.environ,
            "NUMBA_CACHE_DIR": str(tmp_path / cache),
            "PYTHONPATH": str(tmp_path),
        }
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    return run


@pytest.mark.slow
def test_a_program_is_loaded_without_the_compiler(run, tmp_path):
    assert run("sum_of(2, 1.5)") == ["5", "False", "True"]
    assert run("sum_of(2, 1.5)") == ["5", "False", "False"]
    (kept,) = (tmp_path / "cache").rglob("*.program")
    whole = kept.read_bytes()
    for damaged in (whole[: len(whole) // 2], whole[:-9] + bytes(9), b""):
        kept.write_bytes(damaged)
        assert run("sum_of(2, 1.5)") == ["5", "False", "True"]
        assert kept.read_bytes() == whole
    another = "from kernels import *; import mujoco; mujoco.__version__ = '9.9'; sum_of(2, 1.5)"
    assert run(another) == ["5", "False", "True"]


@pytest.mark.slow
def test_what_no_file_has_is_known_by_what_is_written(run):
    """A kernel of a notebook, changed."""
    code = """
text = "@compiled\\ndef inner(x):\\n    return x + {}\\n"
text += "@compiled\\ndef outer(x):\\n    return inner(x) + MORE\\n"
for number, more in ((1, 10), (2, 10), (2, 20)):
    names = {"compiled": compiled, "MORE": more, "__name__": "cell"}
    exec(compile(text.format(number), "<cell>", "exec"), names)
    print(entry(names["outer"], "int64")(0))
"""
    assert run(code) == run(code) == ["11", "12", "22"]


@pytest.mark.slow
def test_where_a_program_cannot_be_kept_it_is_compiled(run, tmp_path):
    (tmp_path / "file").touch()
    for _ in range(2):
        assert run("sum_of(2, 1.5)", cache="file") == ["5", "False", "True"]


@pytest.mark.slow
def test_a_program_takes_numbers_and_nothing_else(run):
    code = """
program = entry(add, "int64", "float64")
for arguments in ((1,), (1, 2.0, 3), ("1", 2.0), (1, None)):
    try:
        program(*arguments)
    except TypeError:
        print("refused")
print(program(1, 2))
"""
    assert run(code) == 4 * ["refused"] + ["5"]


@pytest.mark.slow
def test_two_numbers_that_are_written_out_are_one_type(run):
    code = """
@compiled
def both(x):
    return twice(x) + add(1, 2.0) + add(2, 3.0)

print(both(1.0), len(add.part.overloads))
"""
    assert run(code) == ["15.0", "1"]


NAMES = (
    """
import mujoco
from mjgranular import Bed, HeightField, Plane, laws, media
from mjgranular.errors import UnknownNameError
from mjgranular.law import make_scene
from mjgranular.sand.guard import guarded_program
from mjgranular.scheme.scheme import schemes

XML = """
    + repr("""
<mujoco>
  <asset><hfield name="dune" nrow="4" ncol="4" size="1 1 .2 .1"/></asset>
  <worldbody>
    <geom name="box" type="box" size="1 1 1"/><geom name="dune" type="hfield" hfield="dune"/>
  </worldbody>
</mujoco>
""")
    + """
model = mujoco.MjModel.from_xml_string(XML)
for law in laws.values():
    for medium in media.values():
        try:
            made = law.from_medium(medium)
            break
        except UnknownNameError:
            continue
    for surface in (Plane(), Bed("box"), HeightField("dune")):
        scene = make_scene(made, medium, surface, model)
        for scheme in ("explicit", "implicit"):
            program = schemes[scheme]().program(made.kernel(surface), scene.dtype)
            print(guarded_program(program).py_func.__qualname__)
"""
)


def test_the_kernels_of_all_laws_have_the_same_names_in_every_process():
    """By its name a kernel is found on disk: what is not found is compiled again."""
    command = [sys.executable, "-c", NAMES]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    first, second = map(finish, both)
    assert len(set(first)) == len(first) >= 5 * 3 * 2
    assert first == second


def test_what_has_no_name_of_its_own_is_refused():
    nameless = object()
    with pytest.raises(TypeError, match="names anew: <object object at"):
        compiled(lambda x: nameless)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_who_does_not_look_is_not_told(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", ""), encoding="utf-8")
    env = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    code = "from kernels import *; twice(1.0)"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.slow
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
