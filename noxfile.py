"""The core tests on every Python and MuJoCo that the package says it works with: `nox`.

Interpreters that a machine does not have are skipped. `nox --list` shows the sessions,
`nox -s "core-3.12(mujoco='3.17')"` runs one. `nox -s bounds` runs all tests with compiled code
that checks each index; `nox -s lowest highest` runs them with the lowest and the highest version of
every dependency that pyproject.toml allows.
"""

import nox

PYTHONS = ("3.11", "3.12", "3.13")
MUJOCOS = ("3.17", "4.0")
CORE = (
    "api/test_sand.py", "api/test_step.py", "engine/test_plugin.py", "engine/test_sensor.py",
    "engine/test_tuning.py", "physics/test_implicit.py", "physics/test_surfaces.py",
    "tools/test_elements.py",
)  # fmt: skip
ALL = ("-m", "slow or not slow")  # without it pytest runs the fast tests
TORCH = "torch==2.13.0"  # where an index offers a build without CUDA: smaller by gigabytes

nox.options.default_venv_backend = "uv|virtualenv"
nox.options.sessions = ["core"]
nox.options.error_on_missing_interpreters = False


@nox.session(python=PYTHONS)
@nox.parametrize("mujoco", MUJOCOS)
def core(session: nox.Session, mujoco: str) -> None:
    """What compiled code, structs and the two interfaces depend on."""
    session.install(".[test]", f"mujoco=={mujoco}.*")
    files = [f"tests/{name}" for name in CORE]
    session.run("pytest", "-q", "-p", "no:cacheprovider", *ALL, *files, *session.posargs)


@nox.session(python=PYTHONS[-1])
def bounds(session: nox.Session) -> None:
    """All tests with kernels that check each index; one out of bounds ends the run."""
    session.install(".[test]")
    session.run(
        "pytest", "-q", "-p", "no:cacheprovider", *ALL, *session.posargs,
        env={"NUMBA_BOUNDSCHECK": "1"},
    )  # fmt: skip


@nox.session(python="3.11", venv_backend="uv")
def lowest(session: nox.Session) -> None:
    """The lowest version of every dependency: whether the bounds are true."""
    session.install(TORCH)  # by itself: the lowest build would be the one with CUDA
    session.install("--resolution", "lowest-direct", ".[test]", "pip")
    # What they depend on is new, and deprecates what the old ones do; policies are of MuJoCo 4.
    filters = (
        "error", "ignore:gravity is 0", "ignore::DeprecationWarning",
        "ignore:.* was trained with MuJoCo",
    )  # fmt: skip
    _run_all_tests(session, "-o", "filterwarnings=" + "\n".join(filters))


@nox.session(python=("3.11", "3.13"), venv_backend="uv")
def highest(session: nox.Session) -> None:
    """The newest version of every dependency: whether an upper bound is due."""
    session.install("--upgrade", ".[test]", TORCH, "pip")
    _run_all_tests(session)


def _run_all_tests(session: nox.Session, *options: str) -> None:
    session.run("uv", "pip", "list", external=True)
    session.run("pytest", "-q", "-p", "no:cacheprovider", *ALL, *options, *session.posargs)
