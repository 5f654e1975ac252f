"""Kernels kept on disk: what one process compiled is what another loads."""

import contextlib
import os
import subprocess
import sys

import mujoco
import pytest

from mjgranular.kernel.compiled import compiled, entry
from mjgranular.law import get_law, make_scene
from mjgranular.medium import get_medium
from mjgranular.relief import Memory
from mjgranular.relief.relief import Relief
from mjgranular.scheme import schemes
from mjgranular.surface import Bed, Plane

BLOCK = """
<mujoco><worldbody>
  <geom name="block" type="box" size="1 1 1"/><body><freejoint/><geom size=".1"/></body>
</worldbody></mujoco>
"""

KERNELS = """
import math, sys, time
from pathlib import Path
from mjgranular.kernel import compiled, entry

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

SIGNATURE = "float64(float64)"

def call(names):
    print(*[entry(made_of(INNER[name]), SIGNATURE)(1.0) for name in names])
"""


@pytest.fixture
def start(tmp_path):
    body = "".join(f"        y += math.sin(x + {i}) * math.exp(y)\n" for i in range(40))
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
    out, _ = process.communicate(timeout=600)
    assert process.returncode == 0
    return out.split()


@pytest.mark.slow
def test_kernels_of_one_factory_from_processes_that_compile_at_once(start):
    at_once = [start(f"call('{name}')") for name in "223"]
    assert [finish(process) for process in at_once] == [["2.0"], ["2.0"], ["3.0"]]
    for order in ("23", "32"):
        assert finish(start(f"call('{order}')")) == [f"{name}.0" for name in order]


PROGRAM = """
from numba.core import event

@compiled
def add(n, x):
    return n + int(twice(x))

class Counter(event.Listener):
    count = 0

    def on_start(self, event):
        self.count += 1

    def on_end(self, event):
        pass

def sum_of(n, x):
    counter = Counter()
    with event.install_listener("numba:compile", counter):
        value = entry(add, "int64(int64, float64)")(n, x)
    print(value, counter.count > 0)
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", "") + PROGRAM, encoding="utf-8")

    def run(code, cache="cache", cwd=None):
        command = [sys.executable, "-c", f"from kernels import *\n{code}"]
        env = {
            **os.environ,
            "NUMBA_CACHE_DIR": str(tmp_path / cache),
            "PYTHONPATH": str(tmp_path),
        }
        done = subprocess.run(
            command, env=env, cwd=cwd, capture_output=True, text=True, timeout=600
        )
        assert (done.returncode, done.stderr) == (0, "")  # who does not look is not told
        return done.stdout.split()

    return run


@pytest.mark.slow
def test_a_program_is_loaded_not_compiled_again(run, tmp_path):
    assert run("sum_of(2, 1.5)") == ["5", "True"]
    assert run("sum_of(2, 1.5)") == ["5", "False"]
    (kept,) = (tmp_path / "cache").rglob("*.nbc")
    damage = f"""
kept = Path({str(kept)!r})
whole = kept.read_bytes()
for damaged in (whole[: len(whole) // 2], whole[:-9] + bytes(9), b""):
    kept.write_bytes(damaged)
    for _ in range(2):
        sys.modules["mjgranular.kernel.compiled"]._programs.clear()
        sum_of(2, 1.5)
"""
    assert run(damage) == 3 * ["5", "True", "5", "False"]
    another = "from kernels import *; import mujoco; mujoco.__version__ = '9.9'; sum_of(2, 1.5)"
    assert run(f"import sys; sys.modules.pop('kernels'); {another}") == ["5", "True"]


@pytest.mark.slow
def test_a_kernel_is_compiled_again_when_a_file_that_it_calls_has_changed(run, tmp_path):
    (tmp_path / "inner.py").write_text(
        "from mjgranular.kernel import compiled\n@compiled\ndef grow(x):\n    return x + 1\n"
    )
    code = """
from inner import grow
def made_of(grow):
    @compiled
    def outer(x):
        return grow(x)
    return outer
print(entry(made_of(grow), "int64(int64)")(1))
"""
    assert run(code) == ["2"]
    (tmp_path / "inner.py").write_text(
        "from mjgranular.kernel import compiled\n@compiled\ndef grow(x):\n    return x + 2\n"
    )
    assert run(code) == ["3"]


@pytest.mark.slow
def test_what_no_file_has_is_known_by_what_is_written(run):
    """A kernel of a notebook, changed."""
    code = """
text = "@compiled\\ndef inner(x):\\n    return x + {}\\n"
text += "@compiled\\ndef outer(x):\\n    return inner(x) + MORE\\n"
for number, more in ((1, 10), (2, 10), (2, 20)):
    names = {"compiled": compiled, "MORE": more, "__name__": "cell"}
    exec(compile(text.format(number), "<cell>", "exec"), names)
    print(entry(names["outer"], "int64(int64)")(0))
"""
    assert run(code) == run(code) == ["11", "12", "22"]


@pytest.mark.slow
def test_a_program_takes_numbers_and_nothing_else(run):
    code = """
program = entry(add, "int64(int64, float64)")
for arguments in ((1,), (1, 2.0, 3), ([], 2.0), (1, None)):
    try:
        program(*arguments)
    except TypeError:
        print("refused")
print(program(1, 2))
"""
    assert run(code) == 4 * ["refused"] + ["5"]


NAMES = (
    """
import mujoco
from mjgranular import Bed, HeightField, Plane, laws, media
from mjgranular.errors import UnknownNameError
from mjgranular.law import make_scene
from mjgranular.scheme import schemes

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
        for scheme in ("implicit",) if made.adds_mass else ("explicit", "implicit"):
            chosen, parts = schemes[scheme](), (made.kernel(surface), scene.dtype)
            program = chosen.sampling(*parts) or chosen.program(*parts)
            print(program.py_func.__qualname__)
"""
)


def test_the_kernels_of_all_laws_have_the_same_names_in_every_process():
    """By its name a kernel is found on disk: what is not found is compiled again."""
    command = [sys.executable, "-c", NAMES]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    first, second = map(finish, both)
    assert len(set(first)) == len(first) >= 5 * 3 * 2
    assert first == second


def test_forces_are_one_program_on_all_surfaces():
    model = mujoco.MjModel.from_xml_string(BLOCK)
    medium = get_medium("quikrete_medium")
    law = get_law("rft3d_dynamic", medium)
    made = set()
    for surface in (Plane(), Bed("block"), Relief(Plane(), Memory(), 0.2)):
        dtype = make_scene(law, medium, surface, model).dtype
        forces = schemes["implicit"]().forces(law.kernel(surface), dtype)
        made.add(forces.py_func.__qualname__)
    assert len(made) == 1


BESIDE = """
parts = sys.modules["mjgranular.kernel.compiled"]

def program_addresses(beside):
    local = made_of(twice)
    missing = [(local, SIGNATURE, ""), (None, SIGNATURE, ""), (thrice, SIGNATURE, "")]
    found = parts.program_addresses(*missing)
    print([address > 0 for address in found], len(parts._beside) == beside)
    for process in parts._beside:
        print(process.wait())

"""


def test_a_second_process_compiles_what_a_module_names(start):
    code = (
        BESIDE
        + """
parts._compile_beside([(thrice, SIGNATURE, "")])
assert parts._beside[0].wait() == 0
counted = parts.cache.has(parts.build(), parts._name_of(thrice, SIGNATURE, parts._c_function))
print(counted)
program_addresses(1)  # nothing that a module names is missing any more
"""
    )
    assert "".join(finish(start(code))) == "True[True,False,True]True0"


def test_of_several_programs_one_is_compiled_beside(start):
    assert "".join(finish(start(BESIDE + "program_addresses(1)"))) == "[True,False,True]True0"


def test_what_has_no_name_of_its_own_is_refused():
    nameless = object()
    with pytest.raises(TypeError, match="closure contains <object object at"):
        compiled(lambda x: nameless)


def seen_on_a_terminal(folder, code):
    """What a process writes to a terminal in place of standard error."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(folder)}
    done = subprocess.run([sys.executable, "-c", code], env=env, stderr=theirs, timeout=600)
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
    code = (
        "from kernels import *; entry(twice, SIGNATURE)(1.0); entry(thrice, SIGNATURE)(1.0)\n"
        "import sys; print('.', file=sys.stderr)"
    )
    first, second = seen_on_a_terminal(tmp_path, code), seen_on_a_terminal(tmp_path, code)
    assert first == ["mjgranular: compiling kernels: once on a machine, up to a minute", "."]
    assert second == ["."]
    reads_the_log = (
        "import logging; logging.basicConfig(level='INFO', format='%(message)s')\n"
        f"{code.replace('SIGNATURE', repr('float64(int64)'))}"
    )
    lines = seen_on_a_terminal(tmp_path, reads_the_log)
    assert "compiling kernels.twice" in lines
    assert not any(line.startswith("mjgranular") for line in lines)


def test_who_waits_is_told_what_for(monkeypatch, capsys, caplog):
    caplog.set_level("WARNING", logger="mjgranular.kernel.compiled")  # nobody reads the log
    parts = sys.modules[entry.__module__]  # `kernel.compiled` is the function of that name
    monkeypatch.setattr(parts, "_reported", False)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    for what in ("", "law a", "", "law b"):
        parts.report_compiling("once", what)
    told = ("kernels", "for law a", "for law b")
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"mjgranular: compiling {one}: once" for one in told]


@pytest.mark.slow
def test_without_a_folder_to_write_to_it_says_so_in_every_process(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS.replace("BODY\n", ""), encoding="utf-8")
    code = "from kernels import *; assert entry(twice, SIGNATURE)(1.0) == 2.0"
    (tmp_path / "cache").touch()
    (line,) = seen_on_a_terminal(tmp_path, code)
    assert "in every process" in line
    assert "NUMBA_CACHE_DIR" in line


OWN = "from mjgranular.kernel import compiled\n\n@compiled\ndef grow(x):\n    return x + {}\n"
GROWN = """
import importlib, pathlib, own
def grown():
    importlib.reload(own)
    return entry(own.grow, "int64(int64)")(1)
"""


@pytest.mark.slow
def test_a_kernel_that_is_edited_and_imported_again_is_another(run, tmp_path):
    (tmp_path / "own.py").write_text(OWN.format(1))
    code = f"""{GROWN}
sys.dont_write_bytecode = True
print(grown())
pathlib.Path("own.py").write_text({OWN.format(20)!r})
print(grown())
"""
    assert run(code, cwd=tmp_path) == ["2", "21"]


@pytest.mark.slow
def test_a_kernel_that_is_edited_before_it_is_compiled_is_kept_as_it_was(run, tmp_path):
    (tmp_path / "own.py").write_text(OWN.format(1))
    edited = f'import own, pathlib; pathlib.Path("own.py").write_text({OWN.format(20)!r})\n'
    code = 'import own; print(entry(own.grow, "int64(int64)")(1))'
    assert run(edited + code, cwd=tmp_path) == ["2"]
    assert run(code, cwd=tmp_path) == ["21"]


def test_without_numbas_compiler_a_sand_says_so(tmp_path):
    code = """
import mujoco, mjgranular
from mjgranular.models import Link
spec = Link().spec()
try:
    mjgranular.Sand(spec.compile())
except mjgranular.GranularError as error:
    print(error)
"""
    env = {**os.environ, "NUMBA_DISABLE_JIT": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "unset NUMBA_DISABLE_JIT" in done.stdout
