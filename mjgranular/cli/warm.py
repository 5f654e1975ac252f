"""`mjgranular warm`: compiles ahead what a run needs."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import mujoco
import tyro

from mjgranular.cli.console import err, progress_bar
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
from mjgranular.surface import Bed, HeightField, Plane

_MODEL = """
<mujoco>
  <option timestep="1e-4"/>
  <asset><hfield name="h" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 0 0 0"/></asset>
  <worldbody>
    <geom name="bed" type="box" size="1 1 .1" pos="0 0 -.1" contype="0" conaffinity="0"/>
    <geom name="field" type="hfield" hfield="h" contype="0" conaffinity="0"/>
    <body pos="0 0 1"><freejoint/><geom type="capsule" size=".01 .1"/></body>
  </worldbody>
</mujoco>
"""
_SURFACES = {"plane": Plane(), "bed": Bed("bed"), "height_field": HeightField("field")}
_SCHEMES = ["implicit", "explicit"]
_Work = tuple[str, Callable[[], object]]


@dataclass(frozen=True, kw_only=True)
class WarmCommand(options_of(PlainSand)):
    """Compiles ahead what a run needs: for clusters and containers, where nobody wants to wait.

    Name a model, an environment, or laws and schemes; without any of them, every law under every
    scheme over a plane. What is compiled is kept on disk (NUMBA_CACHE_DIR), for `Sand` and for sand
    inside mj_step.
    """

    model: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[MODEL.xml]")] = None
    """An MJCF file: what it needs with the options of the sand that are given."""
    env: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID ...")] = ()
    """Environments: mjgranular's, such as mjgranular/Hexapod-v0, for on_sand, such as Ant-v5, or
    your own, my_module:My-v0, as they are."""
    over: Annotated[
        tuple[Literal["plane", "bed", "height_field"], ...],
        tyro.conf.arg(metavar="{plane,bed,height_field} ..."),
    ] = ("plane",)
    """Surfaces, where neither model nor environment is named."""

    def run(self) -> int:
        """Runs the command."""
        warnings.simplefilter("ignore", GranularWarning)  # no step here means anything
        works = list(self._works())
        spent = []
        with progress_bar("compiling", len(works)) as progress:
            for number, (what, work) in enumerate(works):
                progress(number, f"{number + 1} of {len(works)}: {what}")
                begin = time.perf_counter()
                work()
                spent.append(time.perf_counter() - begin)
        for (what, _), seconds in zip(works, spent, strict=True):
            err.print(f"ready: {what} ({seconds:.1f} s)", highlight=False)
        return 0

    def _works(self) -> Iterator[_Work]:
        """What is to be compiled, in words, and what compiles it."""
        self._check_options()
        if self.model is not None:
            if self.env:
                raise InputError("name a MODEL.xml or --env ID, not both")
            drop = record_of(Drop, self)
            spec = _read(drop)
            own = any(plugin.plugin_name == NAME for plugin in spec.plugins)
            if not own:
                yield f"{drop.title} and Sand", partial(_step, spec, drop.sand)
            yield f"{drop.title} and mj_step", partial(_step_within, spec, drop.sand, own=own)
            return
        if self.env:
            for identity in self.env:
                yield identity, partial(_step_environment, identity)
            return
        named = law_named(self.law)
        for law in [named] if named else laws:
            medium = self.medium or medium_for(law)
            every = ["implicit"] if law_of(law, get_medium(medium)).adds_mass else _SCHEMES
            for scheme in [self.scheme] if self.scheme != "auto" else every:
                get_scheme(scheme)
                for name in self.over:
                    sand = SandSpec(medium=medium, law=law, scheme=scheme, surface=_SURFACES[name])
                    spec = mujoco.MjSpec.from_string(_MODEL)
                    what = f"law {law}, scheme {scheme}, {name}"
                    yield what, partial(_step, spec, sand)
                    yield f"{what}, inside mj_step", partial(_step_within, spec, sand, own=False)

    def _check_options(self) -> None:
        """Refuses options that would be left aside without a word."""
        of_sand = {field.name for field in fields(PlainSand)}
        if self.model is not None:
            for name in given_options(self, "over"):
                raise InputError(
                    f"{option(name)} is for laws without a model: over {self.model.name} the sand "
                    "is a plane, --bed GEOM or --height-field GEOM"
                )
        elif self.env:
            for name in given_options(self, "over", *of_sand):
                raise InputError(
                    f"{option(name)} goes with a MODEL.xml: an environment has its own sand"
                )
        else:
            for name in given_options(self, *(of_sand - {"law", "medium", "scheme"})):
                raise InputError(f"{option(name)} is of a model: name a MODEL.xml too")


def _read(drop: Drop) -> mujoco.MjSpec:
    with loading(drop.title):
        return read(drop)


def _step(spec: mujoco.MjSpec, sand: SandSpec) -> None:
    model = spec.copy().compile()
    Sand(model, sand).step(mujoco.MjData(model))


def _step_within(spec: mujoco.MjSpec, sand: SandSpec, *, own: bool) -> None:
    within = spec.copy()
    if not own:
        add_sand(within, fitted(spec.copy().compile(), sand))
    with loading(within.modelname):
        model = within.compile()
        mujoco.mj_step(model, mujoco.MjData(model))


def _step_environment(identity: str) -> None:
    from mjgranular.envs import SandEnv, on_sand
    from mjgranular.envs.ids import name_of
    from mjgranular.envs.known import find_spec
    from mjgranular.envs.tasks import tasks
    from mjgranular.learn import environments

    name = name_of(identity)
    if ":" in identity:
        env = environments.one(identity, {})
    else:
        if name not in tasks:
            find_spec(identity)  # which knows of ours too
        env = SandEnv(name) if name in tasks else on_sand(identity)
    try:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    finally:
        env.close()
