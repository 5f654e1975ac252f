"""`mjgranular warm`: compiles ahead what a run needs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated

import mujoco
import tyro

from mjgranular.cli.console import note, progress_bar
from mjgranular.cli.options import given_options, law_named, option, options_of, record_of
from mjgranular.engine import NAME, add_sand
from mjgranular.errors import GranularWarning, InputError
from mjgranular.experiment.drop import Drop, loading, read
from mjgranular.experiment.ground import PlainSand
from mjgranular.law import laws
from mjgranular.medium import get_medium
from mjgranular.sand import Sand, SandSpec
from mjgranular.sand.material import law_of, medium_for
from mjgranular.sand.prepare import fitted
from mjgranular.scheme import get_scheme

_MODEL = """
<mujoco>
  <option timestep="1e-4"/>
  <worldbody>
    <body pos="0 0 1"><freejoint/><geom type="capsule" size=".01 .1"/></body>
  </worldbody>
</mujoco>
"""
_Task = tuple[str, Callable[[], None]]
"""What is compiled, and the function that compiles it by making a step."""


@dataclass(frozen=True, kw_only=True)
class WarmCommand(options_of(PlainSand)):
    """Compile ahead what a run needs, for clusters and containers.

    Name a model, an environment, or laws and schemes; without any of them, every law under every
    scheme over a plane. Compiled code is stored on disk (NUMBA_CACHE_DIR), for `Sand` and for sand
    inside mj_step.
    """

    model: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[MODEL.xml]")] = None
    """An MJCF file: what it needs with the given options of the sand."""
    env: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID ...")] = ()
    """Environments: of mjgranular, such as mjgranular/Hexapod-v0, for on_sand, such as Ant-v5, or
    custom ones, my_module:My-v0, as they are."""

    def run(self) -> int:
        """Run the command."""
        warnings.simplefilter("ignore", GranularWarning)  # the steps are not a simulation
        tasks = list(self._tasks())
        with progress_bar("compiling", len(tasks)) as progress:
            for number, (what, step) in enumerate(tasks):
                progress(number, f"{number + 1} of {len(tasks)}: {what}")
                begin = time.perf_counter()
                step()
                note(f"ready: {what} ({time.perf_counter() - begin:.1f} s)")
        return 0

    def _tasks(self) -> Iterator[_Task]:
        sand = [each.name for each in fields(PlainSand)]
        if self.model is not None:
            if self.env:
                raise InputError("name a MODEL.xml or --env ID, not both")
            yield from self._tasks_of_model()
        elif self.env:
            self._reject("an environment has its own sand", *sand)
            for identity in self.env:
                yield identity, partial(_step_environment, identity)
        else:
            others = [name for name in sand if name not in ("law", "medium", "scheme")]
            self._reject("name a MODEL.xml", *others)
            yield from self._tasks_of_laws()

    def _reject(self, reason: str, *names: str) -> None:
        """Raise if options are given that have no effect."""
        for name in given_options(self, *names):
            raise InputError(f"{option(name)} has no effect here: {reason}")

    def _tasks_of_model(self) -> Iterator[_Task]:
        drop = record_of(Drop, self)
        with loading(drop.title):
            spec = read(drop)
        if any(plugin.plugin_name == NAME for plugin in spec.plugins):
            yield f"{drop.title} and mj_step", partial(_step_inside, spec, None)
        else:
            yield f"{drop.title} and Sand", partial(_step_outside, spec, drop.sand)
            yield f"{drop.title} and mj_step", partial(_step_inside, spec, drop.sand)

    def _tasks_of_laws(self) -> Iterator[_Task]:
        named = law_named(self.law)
        for law in [named] if named else laws:
            medium = self.medium or medium_for(law)
            schemes = ["implicit", "explicit"]
            if law_of(law, get_medium(medium)).adds_mass:
                schemes = ["implicit"]
            for scheme in schemes if self.scheme == "auto" else [self.scheme]:
                get_scheme(scheme)
                sand = SandSpec(medium=medium, law=law, scheme=scheme)
                spec = mujoco.MjSpec.from_string(_MODEL)
                what = f"law {law}, scheme {scheme}"
                yield what, partial(_step_outside, spec, sand)
                yield f"{what}, inside mj_step", partial(_step_inside, spec, sand)


def _step_outside(spec: mujoco.MjSpec, sand: SandSpec) -> None:
    model = spec.copy().compile()
    Sand(model, sand).step(mujoco.MjData(model))


def _step_inside(spec: mujoco.MjSpec, sand: SandSpec | None) -> None:
    """Step a model with sand inside `mj_step`: its own, or this."""
    inside = spec.copy()
    if sand is not None:
        add_sand(inside, fitted(spec.copy().compile(), sand))
    with loading(inside.modelname):
        model = inside.compile()
        mujoco.mj_step(model, mujoco.MjData(model))


def _step_environment(identity: str) -> None:
    from mjgranular.envs import SandEnv, on_sand
    from mjgranular.envs.ids import name_of
    from mjgranular.envs.tasks import tasks
    from mjgranular.learn import environments

    name = name_of(identity)
    if name in tasks:
        env = SandEnv(name)
    elif ":" in identity:
        env = environments.one(identity, {})
    else:
        environments.find_spec(identity)  # lists environments, also of mjgranular
        env = on_sand(identity)
    try:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    finally:
        env.close()
