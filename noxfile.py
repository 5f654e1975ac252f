"""The core tests on every Python and MuJoCo that the package says it works with: `nox`.

Interpreters that a machine does not have are skipped. `nox --list` shows the sessions,
`nox -s "core-3.12(mujoco='3.17')"` runs one. `nox -s bounds` runs the fast tests with compiled code
that checks each index.
"""

import nox

PYTHONS = ("3.11", "3.12", "3.13")
MUJOCOS = ("3.17", "4.0")
CORE = (
    "elements", "engine", "engine_sensor", "engine_tuning", "implicit", "sand", "step", "surfaces",
)  # fmt: skip

nox.options.default_venv_backend = "uv|virtualenv"
nox.options.error_on_missing_interpreters = False


@nox.session(python=PYTHONS)
@nox.parametrize("mujoco", MUJOCOS)
def core(session: nox.Session, mujoco: str) -> None:
    """What compiled code, structs and the two doors depend on."""
    session.install(".[test]", f"mujoco=={mujoco}.*")
    files = [f"tests/test_{name}.py" for name in CORE]
    session.run("pytest", "-q", "-p", "no:cacheprovider", *files, *session.posargs)


@nox.session(python=PYTHONS[-1])
def bounds(session: nox.Session) -> None:
    """The fast tests with kernels that check each index; one out of bounds ends the run."""
    session.install(".[test]")
    session.run(
        "pytest", "-q", "-p", "no:cacheprovider", "-m", "not slow", *session.posargs,
        env={"NUMBA_BOUNDSCHECK": "1"},
    )  # fmt: skip
