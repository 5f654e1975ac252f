"""`mjgranular view`: your own model on sand, or a policy, in a window or a browser."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import mujoco
import tyro

from mjgranular._util.checks import check_count, check_finite
from mjgranular.cli.console import err
from mjgranular.cli.evaluate import find_actor, is_environment
from mjgranular.cli.options import Flag, option, options_of
from mjgranular.engine import NAME, add_sand
from mjgranular.errors import FloorWarning, InputError, loading
from mjgranular.experiment.drop import Drop, make_ready, read, start_from
from mjgranular.experiment.ground import hide_replaced, refuse_floors
from mjgranular.learn import environments
from mjgranular.learn.evaluate import FIRST_SEED
from mjgranular.learn.film import Live
from mjgranular.learn.run import POLICY
from mjgranular.picture.viewer import Switch, check_display, follow, opened
from mjgranular.picture.web import Page, check_address
from mjgranular.render.scenery import place_sun
from mjgranular.sand.prepare import fitted

_NOT_OPTIONS = ("model", "height", "velocity", "duration")
_OF_POLICIES = ("on", "seed", "trust")
_OF_ALL = ("model", "speed", "duration", "web", "port", "host")


@dataclass(frozen=True, kw_only=True)
class ViewCommand(options_of(Drop, without=_NOT_OPTIONS)):
    """Your own MJCF model on sand in MuJoCo's viewer, or a trained policy, in real time.

    Space pauses and resumes, Backspace restarts, a double click and Ctrl with the mouse pull at a
    body. The sand acts inside mj_step, by the plugin mjgranular.sand. A model that contains sand is
    shown with that. A policy is the folder of a run, or a name from `mjgranular list policies`;
    one that follows commands is driven with the arrow keys, dot, slash and Enter.
    """

    model: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MODEL.xml|POLICY")]
    """The MJCF file, or the policy."""
    on: Annotated[str, tyro.conf.arg(metavar="NAME=VALUE,...")] = ""
    """Of a policy: a variant of its environment, for example medium=glass_beads."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = FIRST_SEED
    """Of a policy: the seed of the first episode."""
    trust: Flag = False
    """Import and so execute the module of an environment that only the run's file names."""
    draw: Annotated[
        tuple[Literal["forces", "depth"], ...] | None, tyro.conf.arg(metavar="{forces,depth} ...")
    ] = None
    """Of a model: arrows for forces, dots for elements, colored by depth. Default: forces."""
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0
    """Speed: 1 is real time, 0.1 a tenth of it."""
    duration: Annotated[float | None, tyro.conf.arg(metavar="S")] = None
    """Time after which the window closes by itself [s]. Default: never."""
    web: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Serve a page for a browser instead, with pause, restart and speed; it needs no display."""
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8080
    """Port of the page."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address of the page, by default for this computer and SSH tunnels to it."""

    def run(self) -> int:
        for name, value in (("speed", self.speed), ("duration", self.duration)):
            if value is not None:
                check_finite(f"the {name}", value, positive=True)
        check_count("seed", self.seed, least=0)
        self._check_options()
        if self.web:
            check_address(self.host, self.port)
        elif (self.host, self.port) != (ViewCommand.host, ViewCommand.port):
            raise InputError("--host and --port are for a page: use --web")
        with self._live() if self._is_policy() else nullcontext() as live:
            self._show(live)
        return 0

    def _show(self, live: Live | None) -> None:
        if not self.web:
            check_display()  # after PyTorch, whose import of Triton ends a process with Mesa in it
        switch, camera, step = Switch(speed=self.speed), {}, None
        restart: Callable[[], None]
        if live is None:
            model = self.load()
            data = mujoco.MjData(model)
            restart = partial(start_from, model, data, self.keyframe)
            restart()
        else:
            model, data, step, restart = live.model, live.data, live.step, live.restart
            switch.command, camera = live.command, live.camera
        if self.web:
            page = Page(model, data, switch, self.host, self.port)
            note = f"Open {page.address} in a browser. Ctrl-C ends it."
            shown: Any = closing(page)
        else:
            note = "Space: pause. Backspace: restart. Ctrl and mouse: pull a body."
            if switch.command is not None:
                note += " Up, down: speed. Left, right: turn. Dot, slash: sideways. Enter: stand."
            shown = opened(model, data, switch, camera)
        with shown as viewer:
            err.print(note, style="dim")
            follow(viewer, model, data, switch, duration=self.duration, step=step, restart=restart)

    def _is_policy(self) -> bool:
        if self.model.is_dir() or self.model.name == POLICY:
            return True
        return not (self.model.is_file() or self.model.suffix)

    def _check_options(self) -> None:
        """Check that no option is given that has no effect."""
        for each in fields(self):
            if each.name in _OF_ALL or getattr(self, each.name) == each.default:
                continue
            name = option(each.name)
            if self._is_policy() and each.name not in _OF_POLICIES:
                raise InputError(f"{name} is for models: use --on for the sand of a policy")
            if each.name in _OF_POLICIES and not self._is_policy():
                raise InputError(f"{name} is for policies, and {self.model} is a model")

    @contextmanager
    def _live(self) -> Iterator[Live]:
        """Make the environment of a policy, with the policy in it."""
        name = self.model.as_posix()
        if is_environment(name):
            raise InputError(f"{name} is an environment: name a policy, or the folder of a run")
        actor = find_actor(name, trust=self.trust)
        arguments = actor.arguments_on(self.on) | {"max_episode_steps": -1}  # no limit
        with closing(environments.one(actor.environment, arguments)) as env:
            yield Live(env, actor.make(env), self.seed)

    def load(self) -> mujoco.MjModel:
        """Return the model with sand in it, in daylight."""
        drop = self.experiment(duration=1.0)  # not used
        with loading(drop.title), warnings.catch_warnings():
            spec = read(drop)
            if any(plugin.plugin_name == NAME for plugin in spec.plugins):
                err.print("The model contains sand, and is shown with that.", style="dim")
                return spec.compile()
            make_ready(spec, drop)
            bare = spec.compile()
            draw = ("forces",) if self.draw is None else self.draw
            add_sand(spec, fitted(bare, drop.sand), draw=("surface", *draw))
            if not self.keep_floor:
                refuse_floors(bare, drop.sand)
            warnings.simplefilter("ignore", FloorWarning)
            model = spec.compile()
            hide_replaced(model, drop.sand)
            place_sun(model)
            return model
