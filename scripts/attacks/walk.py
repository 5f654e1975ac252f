"""Step random models through both interfaces, and check each step.

`Sand.step` leads. Before each step the simulation with the plugin gets the same state, so that a
difference between the interfaces is due to one step. Checks:

- values that are not finite are reported, by an error or a MuJoCo warning, at most one step later;
- both interfaces end a step with the same velocities, to 1e-8;
- sand with the implicit scheme adds no energy: its momentum times the velocity at the end of the
  step is at most 1e-10 of the kinetic energy and 1e-12 J, unless a counter or a warning explains
  it;
- the work of the sand, summed from the start, is never positive by more than rounding;
- bodies at rest stay at rest when options change;
- equivalent descriptions of a model give the same motion (`attacks.twins`);
- only errors that the package raises on purpose occur.
"""

from __future__ import annotations

import copy
import warnings
from argparse import Namespace
from collections import Counter
from typing import Any

import mujoco
import numpy as np
from attacks import changes, models, twins
from attacks.draw import Drawn, arguments, draw
from attacks.measure import (
    JOULES,
    SOLVER_ENDS,
    STATE,
    all_finite,
    clear_warnings,
    documented,
    interfaces_may_differ,
    sand_force,
    sand_force_inside,
    sensitivity,
    state_of,
    without_which,
)
from attacks.worker import Case, Finding, Note, Result

from mjgranular import Bed, GranularError, Sand, UnstableError
from mjgranular.engine import add_sand

PATIENCE = 600.0  # [s] per model; kernels may have to be compiled
ALIKE = 1e-8  # difference of interfaces, relative to the speeds
OF_KINETIC = 1e-10
OF_EARLY_END = 1e-8  # if it vanishes with an exact MuJoCo solver: MuJoCo's tolerance
OF_IMPULSE = 1e-13  # rounding, relative to the energy that the sand's impulse alone would make
STILL, MOVED = 1e-7, 1e-5  # [m/s, rad/s]
DIVERGED = 1e7  # accelerations; at 1e10 MuJoCo finds a state bad, and rounding decides
TROUBLES = 8  # after which a model is abandoned

_BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")]
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
_DISCRETE = int(mujoco.mjtIntegrator.mjINT_DISCRETE)
_PGS, _IPC = int(mujoco.mjtSolver.mjSOL_PGS), int(mujoco.mjtEnableBit.mjENBL_IPC)


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List the models of a seed, with the requested laws and kind of events."""
    programs = [p for p in models.PROGRAMS if not options.laws or p[0] in options.laws]
    common = {"seed": options.seed, "steps": options.steps, "kind": options.kind}
    return [{**common, "programs": programs, "bare": False, "number": n} for n in numbers]


def drawn_for(case: Case) -> Drawn:
    """Draw the model of a case."""
    return draw(case["seed"], case["number"], case["steps"], case["programs"], case["kind"])


def describe(case: Case) -> str:
    """Describe a case in lines that can be pasted into a script, with the model as MJCF."""
    drawn = drawn_for(case)
    events = "\n".join(f"{at:4d}  {'; '.join(e)}" for at, e in sorted(drawn.plan.events.items()))
    return f"{drawn.model.xml}\n\n{drawn.kind}: Sand(model, {drawn.model.sand})\n{events}"


def attempt(case: Case, note: Note) -> Result:
    """Step a model, and compare its twins."""
    walk = Walk(drawn_for(case), case["steps"], note, bare=case["bare"])
    walk.run(case["number"])
    if not case["bare"]:
        walk.ask_twins(case["seed"], case["number"], note)
    return Result([*walk.findings.values()], dict(walk.counts))


class Walk:
    """The check of one model.

    Args:
        drawn: the model and its events.
        steps: number of steps.
        note: records the step and the interface before each step.
        bare: step without sand, to find whether a crash is MuJoCo's.
    """

    def __init__(self, drawn: Drawn, steps: int, note: Note, *, bare: bool) -> None:
        self.drawn, self.steps, self.note, self.bare = drawn, steps, note, bare
        self.findings: dict[tuple[str, str], Finding] = {}
        self.counts: Counter[str] = Counter()
        self.heard: list[str] = []  # warnings of Python and of MuJoCo
        self.troubles = 0
        self.pending = False  # NaN in the state of `Sand.step` that is not reported yet
        self.step = -1
        self.begun = 0  # the step of the last restart
        self.asked = 0
        self.given = self.energy = 0.0  # work of the sand since then, and largest kinetic energy

    def run(self, number: int) -> None:
        """Step to the end, or until too much went wrong."""
        mujoco.set_mju_user_warning(lambda text: self.heard.append(str(text)))
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda message, *rest, **more: self.heard.append(str(message))
            if not self.prepare(tunable=number % 4 == 0):
                return
            for step in range(self.steps):
                self.step = step
                lines = self.drawn.plan.events.get(step, ())
                for line in lines:
                    self.happen(line)
                self.one_step()
                if self.troubles > TROUBLES:
                    self.counts["left"] += 1
                    break
            if self.pending:
                self.one_step()

    def prepare(self, *, tunable: bool) -> bool:
        """Make both simulations; return whether there is anything to step."""
        given, xml = arguments(self.drawn.model.sand), self.drawn.model.xml
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.sand: Sand | None = None
        self.inside: mujoco.MjModel | None = None
        refused: dict[str, str] = {}
        if not self.bare:
            try:
                self.note("Sand")
                self.sand = Sand(self.model, **given)
            except GranularError as error:
                refused["step"] = str(error)
            except Exception as error:
                self.find("step", "exception", f"Sand: {error!r}")
            try:
                self.note("add_sand")
                spec = mujoco.MjSpec.from_string(xml)
                # Not possible with memory, and a box of the model cannot be raised.
                fixed = "memory" in given or isinstance(given.get("surface"), Bed)
                add_sand(spec, **given, tunable=tunable and not fixed)
                self.inside = spec.compile()
                self.inner = mujoco.MjData(self.inside)
            except (ValueError, mujoco.FatalError, GranularError) as error:
                refused["plugin"] = str(error)
                self.inside = None
            except Exception as error:
                self.find("plugin", "exception", f"add_sand: {error!r}")
                self.inside = None
        self.data = mujoco.MjData(self.model)
        # Only the plugin can step explicit sand with RK4.
        by_itself = self.model.opt.integrator == _RK4 and "plugin" not in refused
        if len(refused) == 1 and not by_itself:
            self.find(
                next(iter(refused)), "only one interface refuses", next(iter(refused.values()))
            )
        if refused:
            self.counts["refused when made"] += 1
        self.start = state_of(self.model, self.data)
        self.originals = [(m, copy.copy(m)) for m in (self.model, self.inside) if m is not None]
        self.implicit = self.sand is not None and "implicit" in self.sand.scheme.name
        self.product = np.zeros(self.model.nv)
        return self.bare or self.inside is not None or self.sand is not None

    # Events

    def happen(self, line: str) -> None:
        """Run an event on both sides."""
        if line == "report":
            self.ask_for_report()
            return
        changes.run(line, self.model, self.data)
        if self.inside is not None:
            changes.run(line, self.inside, self.inner)

    def ask_for_report(self) -> None:
        """Check that a report has finite forces."""
        if self.sand is None:
            return
        try:
            report = self.sand.report(self.data)
        except GranularError:
            self.counts["reports refused"] += 1
        except Exception as error:
            self.find("report", "exception", repr(error))
        else:
            self.counts["reports"] += 1
            if not all(np.isfinite(body.force).all() for body in report.bodies):
                self.find("report", "silent NaN", "a report with forces that are not finite")

    def one_step(self) -> None:
        """Take one step with each interface, from the same state."""
        self.heard.clear()
        if self.bare:
            self.note(f"step {self.step}, without sand")
            mujoco.mj_step(self.model, self.data)
            return
        before, speed = state_of(self.model, self.data), self.data.qvel.copy()
        outcome = None
        if self.inside is not None:
            mujoco.mj_setState(self.inside, self.inner, before, STATE)
            if self.sand is not None and self.sand.memory is not None:
                self.inner.plugin_state[:] = self.sand.save_memory(self.data)
        if self.sand is not None:
            outcome = self.outer_step(before, speed)
        if self.inside is not None:
            self.inner_step(before, speed, outcome)
        if outcome in ("trouble", "refused"):
            self.recover()

    def outer_step(self, before: np.ndarray, speed: np.ndarray) -> str:
        """Call `Sand.step`; return "fine", "announced", "trouble" or "refused"."""
        assert self.sand is not None
        data = self.data
        must_refuse = self.must_refuse(self.model, inside=False)
        clear_warnings(data)
        counted, applied = self.counters(), data.xfrc_applied.copy()
        self.note(f"step {self.step}, Sand.step")
        self.counts["steps"] += 1
        pending, self.pending = self.pending, False
        try:
            self.sand.step(data)
        except UnstableError as error:
            self.counts["unstable"] += 1
            finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
            if not finite and np.isfinite(before).all():
                self.find("step", "silent NaN", f"the state restored is not finite: {error}")
            return "trouble"
        except GranularError:
            self.counts["refused under way"] += 1
            return "refused"
        except mujoco.FatalError as error:
            self.fatal("step", before, error)
            return "trouble"
        except Exception as error:
            self.find("step", "exception", repr(error))
            return "trouble"
        if must_refuse:
            self.find("step", f"{must_refuse} without a word", "Sand.step goes on")
            return "refused"
        if data.xfrc_applied.tobytes() != applied.tobytes():
            self.find("step", "xfrc_applied changed", "not what it was before the step")
        more = zip(self.counters(), counted or 9 * (0,), strict=False)
        announced = bool(self.heard) or bool(data.warning.number.any())
        announced = announced or any(now > then for now, then in more)
        if pending and not announced:
            self.find("step", "silent NaN", "the step after does not speak of it either")
            return "trouble"
        if not all_finite(data):
            self.pending = not announced
            return "announced"
        if self.implicit:
            force = sand_force(self.sand, data)
            self.weigh_work("step", self.model, data, force, speed, announced, before)
        self.watch_rest()
        return "announced" if announced else "fine"

    def inner_step(self, before: np.ndarray, speed: np.ndarray, outcome: str | None) -> None:
        """Call `mj_step` with the plugin, and compare; `outcome` is what `outer_step` returned."""
        assert self.inside is not None
        data, model = self.inner, self.inside
        must_refuse = self.must_refuse(model, inside=True)
        self.heard.clear()
        clear_warnings(data)
        self.note(f"step {self.step}, plugin")
        self.counts["steps inside"] += 1
        lost = True
        try:
            mujoco.mj_step(model, data)
            lost = self.check_inner(before, speed, outcome, must_refuse)
        except mujoco.FatalError as error:
            if "mjgranular" in str(error):
                self.counts["refused under way, inside"] += 1
                expected = must_refuse or interfaces_may_differ(self.model)
                if outcome in ("fine", "announced") and not expected:
                    self.find("plugin", "only one interface refuses", str(error))
            else:
                self.fatal("plugin", before, error)
        except Exception as error:
            self.find("plugin", "exception", repr(error))
            return
        if outcome is None:  # the plugin is the only interface: it leads
            if lost:
                self.recover()
            else:
                mujoco.mj_setState(self.model, self.data, state_of(model, data), STATE)

    def check_inner(
        self, before: np.ndarray, speed: np.ndarray, outcome: str | None, must_refuse: str
    ) -> bool:
        """Check a step with the plugin; return whether the simulation is lost."""
        assert self.inside is not None
        data, model = self.inner, self.inside
        bad = bool(data.warning.number[_BAD].any())
        announced = bool(data.warning.number.any()) or bool(self.heard)
        if must_refuse and not announced:
            self.find("plugin", f"{must_refuse} without a word", "mj_step goes on")
            return True
        if not all_finite(data) and not announced:
            mujoco.mj_step(model, data)  # MuJoCo checks at the beginning of a step
            if not data.warning.number.any():
                self.find("plugin", "silent NaN", "the step after does not speak of it either")
            return True
        if outcome is None:
            return bad
        if outcome == "refused":
            if not must_refuse and not announced and not self.must_refuse(model, inside=False):
                self.find("step", "only one interface refuses", "mj_step goes on")
        elif bad != (outcome == "trouble"):
            if outcome == "fine" or (outcome == "trouble" and not announced):
                words = ("finds nothing bad", "finds something bad")
                fastest = float(np.abs(data.qacc).max())
                text = f"Sand.step: {outcome}; mj_step {words[bad]}, qacc {fastest:.3g}"
                failed = not interfaces_may_differ(self.model) and fastest < DIVERGED
                self.find("both", "only one interface finds it bad", text, failed=failed)
        elif outcome == "fine" and not announced:
            if self.implicit:
                force = sand_force_inside(data)
                self.weigh_work("plugin", model, data, force, speed, False, before)
            self.compare_interfaces(speed, before)
        return False

    # Checks of a step

    def compare_interfaces(self, speed: np.ndarray, before: np.ndarray) -> None:
        """Compare velocities at the end of the step, relative to the speeds."""
        assert self.inside is not None
        if interfaces_may_differ(self.model):
            return
        self.counts["steps compared"] += 1
        data, h = self.data, abs(float(self.model.opt.timestep))
        apart = float(np.abs(data.qvel - self.inner.qvel).max())
        if apart <= 1e-13:
            return
        forces = (data.qfrc_bias, data.qfrc_actuator, data.qfrc_applied, data.qfrc_passive)
        pushed = sum(np.abs(force) for force in forces) / np.maximum(self.model.dof_M0, 1e-9)
        gained = h * float(np.linalg.norm(pushed, np.inf))
        scale = max(np.abs(speed).max(), np.abs(data.qvel).max(), gained)
        if apart <= ALIKE * scale:
            return
        text = f"by {apart:.3g} of {scale:.3g}"
        if apart <= 10.0 * sensitivity(self.inside, self.inner, before, scale / max(h, 1e-12)):
            self.find("both", "interfaces differ (rounding alone does that)", text, failed=False)
        else:
            self.find("both", "interfaces differ", text, apart / scale)

    def weigh_work(
        self,
        interface: str,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        force: np.ndarray,
        speed: np.ndarray,
        announced: bool,
        before: np.ndarray,
    ) -> None:
        """Check the true work of the sand, with the velocities at the end of the step [J]."""
        h = float(model.opt.timestep)
        if not (0.0 < h < 1e3) or not np.isfinite(force).all():
            return
        work = h * float(force @ data.qvel)
        self.counts["steps weighed"] += 1
        if interface == "step":
            self.sum_work(work, model, data, speed)
        if work <= JOULES:
            return
        kinetic = max(self.kinetic(model, data, v) for v in (speed, data.qvel))
        impulse = 0.5 * h * h * float((force * force / np.maximum(model.dof_M0, 1e-9)).sum())
        if work <= OF_KINETIC * kinetic + JOULES + OF_IMPULSE * impulse:
            return
        reason = documented(model) or ("counted or warned of" if announced else "")
        missing = ""
        if not reason and self.asked <= 5:
            self.asked += 1
            missing = without_which(self.model, self.drawn.model.sand, before)
            if missing == SOLVER_ENDS and work <= OF_EARLY_END * kinetic:
                reason = "within the tolerance of the engine's solver"
        kind = f"energy ({reason})" if reason else f"energy{missing}"
        text = f"{work:.3g} J in a step, of {kinetic:.3g} J"
        self.find(interface, kind, text, work / max(kinetic, JOULES), failed=not reason)

    def sum_work(
        self, work: float, model: mujoco.MjModel, data: mujoco.MjData, speed: np.ndarray
    ) -> None:
        """Sum the work since the start, including counted and reported steps."""
        self.energy = max(self.energy, self.kinetic(model, data, speed))
        self.given += work
        if self.given > OF_KINETIC * self.energy + self.step * JOULES and not documented(model):
            text = f"{self.given:.3g} J since step {self.begun}, of {self.energy:.3g} J"
            value = self.given / max(self.energy, JOULES)
            self.find("step", "energy, summed", text, value, failed=self.drawn.kind != "hostile")

    def kinetic(self, model: mujoco.MjModel, data: mujoco.MjData, speed: np.ndarray) -> float:
        """Return the kinetic energy at a velocity, at least 0 [J]."""
        mujoco.mj_mulM(model, data, self.product, np.ascontiguousarray(speed))
        return max(0.0, 0.5 * float(speed @ self.product))

    def ask_twins(self, seed: int, number: int, note: Note) -> None:
        """Check that equivalent descriptions of the model give the same motion."""
        program = self.drawn.model.program
        if program[2] != "implicit" or self.drawn.kind == "rest":
            return
        note("twins")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name, off, failed in twins.ask(seed, number, program):
                self.counts[f"twins: {name}"] += 1
                if failed or (name == "rounding alone" and off > ALIKE):
                    self.find("twins", name, f"{off:.3g} of the speed apart", off, failed)

    def watch_rest(self) -> None:
        """Check that bodies at rest stay at rest."""
        settled = self.drawn.plan.settled
        if settled is None or self.step < settled - 1:
            return
        fastest = float(np.abs(self.data.qvel).max())
        if self.step == settled - 1:
            self.still = fastest < STILL
            self.counts["settled" if self.still else "not settled"] += 1
        elif self.still and fastest > MOVED:
            self.find("step", "rest is lost", f"{fastest:.3g} m/s", fastest)

    def must_refuse(self, model: mujoco.MjModel, *, inside: bool) -> str:
        """Return the integrator if it cannot be stepped with this sand, else an empty string."""
        implicit = self.implicit or (self.sand is None and not inside)
        if model.opt.integrator == _RK4 and (implicit or not inside):
            return "RK4"
        other = model.opt.solver == _PGS or model.opt.enableflags & _IPC
        if model.opt.integrator == _DISCRETE and implicit and other:
            return "discrete"
        return ""

    # Helpers of the checks

    def counters(self) -> tuple[int, ...]:
        """Return the scheme's counts of unfinished and damped steps."""
        assert self.sand is not None
        binding = self.sand._bindings.get(self.data)
        if binding is None or binding.workspace.statistics is None:
            return ()
        account = binding.workspace.statistics[0]
        skipped = ("steps", "evaluations", "most")
        integers = [name for name in account.dtype.names if account.dtype[name] == np.int64]
        return tuple(int(account[name]) for name in integers if name not in skipped)

    def fatal(self, interface: str, before: np.ndarray, error: Exception) -> None:
        """Record a MuJoCo error, unless the same step without sand has it too."""
        for data in (mujoco.MjData(self.model), self.data):
            mujoco.mj_setState(self.model, data, before, STATE)
            try:
                mujoco.mj_step(self.model, data)
            except mujoco.FatalError:
                self.counts["errors of MuJoCo's own"] += 1
                return
        self.find(interface, "exception", f"mujoco.FatalError: {error}")

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

    def find(
        self, interface: str, kind: str, text: str, value: float = 0.0, failed: bool = True
    ) -> None:
        """Record a finding; only the worst of each kind is kept per model."""
        self.counts[f"found: {kind}"] += 1
        known = self.findings.get((kind, interface))
        if known is None or value > known.value:
            found = Finding(kind, text, f"step {self.step}, {interface}", float(value), failed)
            self.findings[kind, interface] = found


def _restore(changed: Any, original: Any) -> None:
    """Restore all numbers of a model, or of its options."""
    for name in dir(original):
        value = getattr(original, name)
        if isinstance(value, np.ndarray) and value.flags.writeable:
            getattr(changed, name)[:] = value
        elif isinstance(original, mujoco.MjOption) and isinstance(value, (int, float)):
            setattr(changed, name, value)
