"""Step random models through both interfaces, and check each step.

`Sand.step` leads. Before each step the simulation with the plugin gets the same state, so that a
difference between the interfaces is due to one step. Checks, by the name in the table:

- finite: values that are not finite are reported, by an error or a MuJoCo warning, at most one step
  later;
- interfaces: both end a step with the same velocities, to 1e-8, and raise errors for the same;
- energy: sand with the implicit scheme adds none: its work with the velocity at the end of the step
  is at most 1e-10 of the kinetic energy and 1e-12 J, unless a counter or a warning explains it;
- energy, summed: its work from the start is never positive by more than rounding;
- rest: bodies at rest stay at rest when options change;
- errors: only errors that the package raises on purpose occur, and they occur where a step is
  impossible;
- user's forces: `xfrc_applied` is unchanged after a step.
"""

from __future__ import annotations

import copy
import warnings
from typing import Any

import mujoco
import numpy as np
from attacks import measure, motions
from attacks.cases import ModelCase, Result, arguments
from attacks.measure import JOULES, STATE
from attacks.motions import draw as draw

from mjgranular import Bed, GranularError, Sand, UnstableError
from mjgranular.engine import add_sand

ALIKE = 1e-8  # difference of interfaces, relative to the speeds
OF_KINETIC = 1e-10
OF_EARLY_END = 1e-8  # if it vanishes with an exact MuJoCo solver: MuJoCo's tolerance
OF_IMPULSE = 1e-13  # rounding, relative to the energy that the sand's impulse alone would make
STILL, MOVED = 1e-7, 1e-5  # [m/s, rad/s]
DIVERGED = 1e7  # accelerations; at 1e10 MuJoCo finds a state bad, and rounding decides
TROUBLES = 8  # after which a model is abandoned
SOLVED = 5  # steps of a model that are solved again with an exact MuJoCo solver

_BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")]
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
_DISCRETE = int(getattr(mujoco.mjtIntegrator, "mjINT_DISCRETE", -1))
_PGS, _IPC = int(mujoco.mjtSolver.mjSOL_PGS), int(mujoco.mjtEnableBit.mjENBL_IPC)


def run(case: ModelCase) -> Result:
    """Step a model to the end, or until too much went wrong."""
    heard: list[str] = []
    mujoco.set_mju_user_warning(lambda text: heard.append(str(text)))
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, *rest, **more: heard.append(str(message))
        walk = Walk(case, heard)
        walk.run()
    return walk.result


class Walk:
    """Both simulations of one model, and what is known of them.

    Args:
        case: the model and its events.
        heard: warnings of Python and of MuJoCo, which others append.
    """

    def __init__(self, case: ModelCase, heard: list[str]) -> None:
        self.case, self.result, self.heard = case, Result(), heard
        self.step = -1
        self.troubles = self.solved = 0
        self.pending = False  # NaN in the state of `Sand.step` that is not reported yet
        self.begun = 0  # the step of the last restart
        self.given = self.energy = 0.0  # work of the sand since then, and largest kinetic energy
        self.still = False
        self.model = mujoco.MjModel.from_xml_string(case.xml)
        self.data = mujoco.MjData(self.model)
        self.start = measure.state_of(self.model, self.data)
        self.sand: Sand | None = None
        self.inside: mujoco.MjModel | None = None
        self.make_both()
        self.implicit = self.sand is not None and "implicit" in self.sand.scheme.name
        made = [model for model in (self.model, self.inside) if model is not None]
        self.originals = [(model, copy.copy(model)) for model in made]

    def make_both(self) -> None:
        """Make the sand of both interfaces; they must raise an error for the same models."""
        given, errors = arguments(self.case.sand), []
        try:
            self.sand = Sand(self.model, **given)
        except GranularError as error:
            errors.append(f"Sand: {error}")
        # Tuning is not possible with memory, and a box of the model cannot be raised.
        fixed = "memory" in given or isinstance(given.get("surface"), Bed)
        try:
            spec = mujoco.MjSpec.from_string(self.case.xml)
            add_sand(spec, **given, tunable=self.case.number % 4 == 0 and not fixed)
            model = spec.compile()
            self.inner, self.inside = mujoco.MjData(model), model
        except (ValueError, mujoco.FatalError, GranularError) as error:
            errors.append(f"plugin: {error}")
        self.result.counts["interfaces"] += 1
        if len(errors) == 1:
            self.fail("interfaces", f"only one raises an error: {errors[0]}")

    def run(self) -> None:
        """Step with events, until all steps are made or too much went wrong."""
        if self.sand is None and self.inside is None:
            return
        events = [*self.case.events]
        for step in range(self.case.steps):
            self.step = step
            while events and events[0][0] == self.step:
                self.happen(events.pop(0)[1])
            self.take_step()
            if self.troubles > TROUBLES:
                break
        if self.pending:
            self.take_step()

    def happen(self, line: str) -> None:
        """Run an event on both sides, or check that a report has finite forces."""
        if line != "report":
            motions.run(line, self.model, self.data)
            if self.inside is not None:
                motions.run(line, self.inside, self.inner)
        elif self.sand is not None:
            try:
                bodies = self.sand.report(self.data).bodies
            except GranularError:
                return
            if not all(np.isfinite(body.force).all() for body in bodies):
                self.fail("finite", "a report with forces that are not finite")

    def take_step(self) -> None:
        """Take one step with each interface, from the same state."""
        before, speed = measure.state_of(self.model, self.data), self.data.qvel.copy()
        outcome = None
        if self.inside is not None:
            mujoco.mj_setState(self.inside, self.inner, before, STATE)
            if self.sand is not None and self.sand.memory is not None:
                self.inner.plugin_state[:] = self.sand.save_memory(self.data)
        if self.sand is not None:
            outcome = self.step_outside(self.sand, before, speed)
        if self.inside is not None:
            lost = self.step_inside(self.inside, before, speed, outcome)
            if outcome is None and lost:  # the plugin is the only interface: it leads
                self.recover()
            elif outcome is None:
                mujoco.mj_setState(
                    self.model, self.data, measure.state_of(self.inside, self.inner), STATE
                )
        if outcome in ("trouble", "error"):
            self.recover()

    def step_outside(self, sand: Sand, before: np.ndarray, speed: np.ndarray) -> str:
        """Call `Sand.step`; return "fine", "announced", "trouble" or "error"."""
        data = self.data
        impossible = self.impossible(self.model, inside=False)
        self.heard.clear()
        measure.clear_warnings(data)
        counted, applied = measure.counters(sand, data), data.xfrc_applied.copy()
        self.result.counts.update(("finite", "errors", "user's forces"))
        pending, self.pending = self.pending, False
        try:
            sand.step(data)
        except UnstableError as error:
            finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
            if not finite and np.isfinite(before).all():
                self.fail("finite", f"the restored state is not finite: {error}")
            return "trouble"
        except GranularError:
            return "error"
        except mujoco.FatalError as error:
            self.check_fatal(before, error)
            return "trouble"
        if impossible:
            self.fail("errors", f"Sand.step makes a step that cannot be made: {impossible}")
            return "error"
        if data.xfrc_applied.tobytes() != applied.tobytes():
            self.fail("user's forces", "xfrc_applied is not what it was before the step")
        more = zip(measure.counters(sand, data), counted or 9 * (0,), strict=False)
        announced = bool(self.heard) or bool(data.warning.number.any())
        announced = announced or any(now > then for now, then in more)
        if pending and not announced:
            self.fail("finite", "neither a step nor the one after reports it")
            return "trouble"
        if not measure.is_finite(data):
            self.pending = not announced
            return "announced"
        if self.implicit:
            work = self.weigh(
                self.model, data, measure.sand_force(sand, data), speed, before, announced
            )
            self.sum_work(work, speed)
        self.watch_rest()
        return "announced" if announced else "fine"

    def step_inside(
        self, model: mujoco.MjModel, before: np.ndarray, speed: np.ndarray, outcome: str | None
    ) -> bool:
        """Call `mj_step` with the plugin, and compare; return whether the simulation is lost.

        Args:
            model: the model with the plugin.
            before: state before the step.
            speed: velocities before the step.
            outcome: what `step_outside` returned; None if only the plugin has sand.
        """
        data = self.inner
        impossible = self.impossible(model, inside=True)
        may_differ = measure.interfaces_may_differ(self.model)
        self.heard.clear()
        measure.clear_warnings(data)
        self.result.counts.update(("finite", "errors", "interfaces"))
        try:
            mujoco.mj_step(model, data)
        except mujoco.FatalError as error:
            if "mjgranular" not in str(error):
                self.check_fatal(before, error)
            elif outcome in ("fine", "announced") and not impossible and not may_differ:
                self.fail("interfaces", f"only mj_step raises an error: {error}")
            return True
        bad = bool(data.warning.number[_BAD].any())
        announced = bool(data.warning.number.any()) or bool(self.heard)
        if impossible and not announced:
            self.fail("errors", f"mj_step makes a step that cannot be made: {impossible}")
            return True
        if not measure.is_finite(data) and not announced:
            mujoco.mj_step(model, data)  # MuJoCo checks at the beginning of a step
            if not data.warning.number.any():
                self.fail("finite", "neither mj_step nor the one after reports it")
            return True
        if outcome == "error":
            if not (impossible or announced or self.impossible(model, inside=False)):
                self.fail("interfaces", "only Sand.step raises an error")
        elif outcome is not None and bad != (outcome == "trouble"):
            fastest = float(np.abs(data.qacc).max())
            expected = outcome == "announced" or (outcome == "trouble" and announced)
            if not expected and not may_differ and fastest < DIVERGED:
                self.fail(
                    "interfaces", f"Sand.step: {outcome}; mj_step: {'' if bad else 'not '}bad"
                )
        elif outcome == "fine" and not announced:
            if self.implicit:
                self.weigh(model, data, measure.sand_force_inside(data), speed, before, False)
            if not may_differ:
                self.compare(model, speed, before)
        return outcome is None and bad

    # Checks of a step

    def compare(self, model: mujoco.MjModel, speed: np.ndarray, before: np.ndarray) -> None:
        """Compare velocities at the end of the step, relative to the speeds."""
        data, h = self.data, abs(float(self.model.opt.timestep))
        apart = float(np.abs(data.qvel - self.inner.qvel).max())
        forces = (data.qfrc_bias, data.qfrc_actuator, data.qfrc_applied, data.qfrc_passive)
        pushed = sum(np.abs(force) for force in forces) / np.maximum(self.model.dof_M0, 1e-9)
        gained = h * float(np.linalg.norm(pushed, np.inf))
        scale = max(np.abs(speed).max(), np.abs(data.qvel).max(), gained)
        if apart <= 1e-13 or apart <= max(ALIKE, self.model.opt.tolerance) * scale:
            return
        if apart > 10.0 * measure.sensitivity(model, self.inner, before, scale / max(h, 1e-12)):
            self.fail("interfaces", f"apart by {apart:.3g} of {scale:.3g}")

    def weigh(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        force: np.ndarray,
        speed: np.ndarray,
        before: np.ndarray,
        announced: bool,
    ) -> float:
        """Check the true work of the sand, with the velocities at the end; return it [J]."""
        h = float(model.opt.timestep)
        if not (0.0 < h < 1e3) or not np.isfinite(force).all():
            return 0.0
        work = h * float(force @ data.qvel)
        self.result.counts["energy"] += 1
        if work <= JOULES or announced or measure.is_excluded(model):
            return work
        kinetic = max(measure.kinetic_energy(model, data, v) for v in (speed, data.qvel))
        impulse = 0.5 * h * h * float((force * force / np.maximum(model.dof_M0, 1e-9)).sum())
        if work <= OF_KINETIC * kinetic + JOULES + OF_IMPULSE * impulse:
            return work
        if work <= OF_EARLY_END * kinetic and self.solved < SOLVED:
            self.solved += 1
            if measure.vanishes_if_solved(self.model, self.case.sand, before):
                return work
        self.fail("energy", f"{work:.3g} J in a step, of {kinetic:.3g} J")
        return work

    def sum_work(self, work: float, speed: np.ndarray) -> None:
        """Check the work since the start, including counted and reported steps."""
        self.energy = max(self.energy, measure.kinetic_energy(self.model, self.data, speed))
        self.given += work
        if self.case.kind == "hostile" or measure.is_excluded(self.model):
            return
        self.result.counts["energy, summed"] += 1
        if self.given > OF_KINETIC * self.energy + self.step * JOULES:
            text = f"{self.given:.3g} J since step {self.begun}, of {self.energy:.3g} J"
            self.fail("energy, summed", text)

    def watch_rest(self) -> None:
        """Check that bodies at rest stay at rest."""
        settled = self.case.settled
        if settled is None or self.step < settled - 1:
            return
        fastest = float(np.abs(self.data.qvel).max())
        if self.step == settled - 1:
            self.still = fastest < STILL
        elif self.still:
            self.result.counts["rest"] += 1
            if fastest > MOVED:
                self.fail("rest", f"{fastest:.3g} m/s")

    def impossible(self, model: mujoco.MjModel, *, inside: bool) -> str:
        """Return the integrator if it cannot be stepped with this sand, else an empty string."""
        implicit = self.implicit or (self.sand is None and not inside)
        if model.opt.integrator == _RK4:
            return "RK4"
        other = model.opt.solver == _PGS or model.opt.enableflags & _IPC
        return "discrete" if model.opt.integrator == _DISCRETE and implicit and other else ""

    def check_fatal(self, before: np.ndarray, error: Exception) -> None:
        """Record an error of MuJoCo, unless the same step without sand has it too."""
        for data in (mujoco.MjData(self.model), self.data):
            mujoco.mj_setState(self.model, data, before, STATE)
            try:
                mujoco.mj_step(self.model, data)
            except mujoco.FatalError:
                return
        self.fail("errors", f"mujoco.FatalError: {error}")

    def fail(self, check: str, text: str) -> None:
        """Record a failure with its step."""
        self.result.fail(check, f"step {self.step}: {text}")

    def recover(self) -> None:
        """Start over, with the original model."""
        self.troubles += 1
        self.begun = self.step + 1
        self.given = self.energy = 0.0
        self.pending = False
        for model, original in self.originals:
            _restore(model, original)
            _restore(model.opt, original.opt)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self.start, STATE)
        if self.sand is not None:
            self.sand.release(self.data)
        if self.inside is not None:
            mujoco.mj_resetData(self.inside, self.inner)


def _restore(changed: Any, original: Any) -> None:
    """Restore all numbers of a model, or of its options."""
    for name in dir(original):
        value = getattr(original, name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            getattr(changed, name)[:] = value
        elif isinstance(original, mujoco.MjOption) and isinstance(value, (int, float)):
            setattr(changed, name, value)
