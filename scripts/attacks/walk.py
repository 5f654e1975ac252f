"""One random model through both doors, step by step, and what is asked of each step.

`Sand.step` walks; before each step the plugin's simulation is brought to the same state, so that a
difference between the doors belongs to one step. What is asked:

- nothing that is not finite comes without a word: an error, or a warning of MuJoCo's, at the latest
  in the next step;
- both doors end a step with the same velocities, to 1e-8;
- the implicit scheme's sand gives no energy: its momentum times the velocity that the step has
  really ended with is at most 1e-10 of the kinetic energy and 1e-12 J, unless a counter or a
  warning says why not;
- what lies still goes on lying still when options change;
- the sand's work since the beginning is never above zero, by more than rounding;
- the same thing moves alike however it is described (`attacks.twins`);
- no error but those that the package raises on purpose.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable

import mujoco
import numpy as np
from attacks import changes, twins
from attacks.draw import Drawn, arguments
from attacks.finding import Finding
from attacks.measure import (
    JOULES,
    SOLVER_ENDS,
    STATE,
    all_finite,
    documented,
    doors_may_differ,
    quiet,
    sand_force,
    sand_force_inside,
    sensitivity,
    state_of,
    without_which,
)
from attacks.original import Original

from mjgranular import Bed, GranularError, Sand, UnstableError
from mjgranular.engine import add_sand

ALIKE = 1e-8  # doors, in parts of the speeds at hand
OF_KINETIC = 1e-10
OF_EARLY_END = 1e-8  # where it is gone with an exact engine's solver: MuJoCo's own tolerance
OF_IMPULSE = 1e-13  # rounding, in parts of the energy that the sand's impulse alone would make
STILL, MOVED = 1e-7, 1e-5  # [m/s, rad/s]
LEFT_REASON = 1e7  # accelerations; at 1e10 MuJoCo finds a state bad, and rounding decides
TROUBLES = 8  # after which a model is left

_BAD = tuple(
    int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{what}")) for what in ("QPOS", "QVEL", "QACC")
)
_RK4 = int(mujoco.mjtIntegrator.mjINT_RK4)
_DISCRETE = int(mujoco.mjtIntegrator.mjINT_DISCRETE)
_PGS, _IPC = int(mujoco.mjtSolver.mjSOL_PGS), int(mujoco.mjtEnableBit.mjENBL_IPC)


class Walk:
    """One model.

    Args:
        seed: of all that is drawn.
        number: of the model.
        steps: how many.
        drawn: the model, if it is not what is drawn for seed and number.
        place: is told the number of the step and the door before each.
        bare: steps without sand, to see whether what happens is MuJoCo's own.
    """

    def __init__(
        self,
        seed: int,
        number: int,
        steps: int,
        drawn: Drawn,
        *,
        place: Callable[[int, int], None] = lambda step, door: None,
        bare: bool = False,
    ) -> None:
        self.seed, self.number, self.steps, self.drawn = seed, number, steps, drawn
        self.place, self.bare = place, bare
        self.findings: list[Finding] = []
        self.counts: Counter[str] = Counter()
        self.told: list[str] = []  # of Python's warnings and MuJoCo's
        self.troubles = 0
        self.pending = False  # NaN in the state of the first door, of which nobody has heard yet
        self.step = -1
        self.begun = 0  # the step at which it last began
        self.asked = 0
        self.given = self.energy = 0.0  # work of the sand since it last began, and energy put in

    # The beginning

    def run(self) -> None:
        """Walks to the end, or until it makes no sense any more."""
        mujoco.set_mju_user_warning(lambda text: self.told.append(str(text)))
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda message, *rest, **more: self.told.append(str(message))
            if not self.prepare():
                return
            for step in range(self.steps):
                self.step = step
                lines = self.drawn.plan.events.get(step, ())
                for line in lines:
                    self.happen(line)
                self.one_step(touched=bool(lines))
                if self.troubles > TROUBLES:
                    self.counts["left"] += 1
                    break
            if self.pending:
                self.one_step(touched=True)

    def prepare(self) -> bool:
        """Makes both simulations; whether there is anything to walk."""
        given = arguments(self.drawn.model.sand)
        self.model = mujoco.MjModel.from_xml_string(self.drawn.model.xml)
        self.sand: Sand | None = None
        self.inside: mujoco.MjModel | None = None
        refused: dict[str, str] = {}
        if not self.bare:
            try:
                self.place(-1, 0)
                self.sand = Sand(self.model, **given)
            except GranularError as error:
                refused["step"] = str(error)
            except Exception as error:
                self.find("step", "exception", f"Sand: {error!r}")
            try:
                self.place(-1, 1)
                spec = mujoco.MjSpec.from_string(self.drawn.model.xml)
                # Memory excludes it, and a box of the model cannot be raised.
                fixed = "memory" in given or isinstance(given.get("surface"), Bed)
                tunable = self.number % 4 == 0 and not fixed
                add_sand(spec, **given, tunable=tunable)
                self.inside = spec.compile()
                self.inner = mujoco.MjData(self.inside)
            except (ValueError, mujoco.FatalError, GranularError) as error:
                refused["plugin"] = str(error)
                self.inside = None
            except Exception as error:
                self.find("plugin", "exception", f"add_sand: {error!r}")
                self.inside = None
        self.data = mujoco.MjData(self.model)
        # Explicit sand may be stepped by RK4 from inside alone.
        by_itself = self.model.opt.integrator == _RK4 and "plugin" not in refused
        if len(refused) == 1 and not by_itself:
            self.find(*refused, "only one door refuses", next(iter(refused.values())))  # type: ignore[call-arg]
        if refused:
            self.counts["refused when made"] += 1
        self.start = state_of(self.model, self.data)
        self.original = Original(self.model)
        self.implicit = "implicit" in (self.sand.scheme.name if self.sand else "")
        if self.inside is None and self.sand is None and not self.bare:
            return False
        if self.inside is not None and self.sand is None:
            self.implicit = False  # explicit, RK4
        self.product = np.zeros(self.model.nv)
        return True

    # What happens

    def happen(self, line: str) -> None:
        """Makes an event happen on both sides."""
        if line == "report":
            self.ask_for_report()
            return
        changes.run(line, self.model, self.data)
        if self.inside is not None:
            changes.run(line, self.inside, self.inner)

    def ask_for_report(self) -> None:
        if self.sand is None:
            return
        try:
            report = self.sand.report(self.data)
        except GranularError:
            self.counts["reports refused"] += 1
            return
        except Exception as error:
            self.find("report", "exception", repr(error))
            return
        self.counts["reports"] += 1
        finite = all(np.isfinite(body.force).all() for body in report.bodies)
        if not finite:
            self.find("report", "silent NaN", "a report with forces that are not finite")

    def one_step(self, *, touched: bool) -> None:
        """One step by each door, from one state."""
        self.told.clear()
        before = state_of(self.model, self.data)
        speed = self.data.qvel.copy()
        heard = None
        if self.bare:
            self.place(self.step, 2)
            mujoco.mj_step(self.model, self.data)
            self.counts["steps"] += 1
            return
        if self.inside is not None:
            mujoco.mj_setState(self.inside, self.inner, before, STATE)
            if self.sand is not None and self.sand.memory is not None:
                self.inner.plugin_state[:] = self.sand.save_memory(self.data)
        if self.sand is not None:
            heard = self.outer_step(before, speed)
        if self.inside is not None:
            self.inner_step(before, speed, heard)
        if heard in ("trouble", "refused"):
            self.recover()

    def outer_step(self, before: np.ndarray, speed: np.ndarray) -> str:
        """One `Sand.step`; says "fine", "announced", "trouble" or "refused"."""
        assert self.sand is not None
        data, model = self.data, self.model
        must_refuse = self.must_refuse(model, inside=False)
        quiet(data)
        counted = self.counters()
        applied = data.xfrc_applied.copy()
        self.place(self.step, 0)
        self.counts["steps"] += 1
        try:
            self.sand.step(data)
        except UnstableError as error:
            self.counts["unstable"] += 1
            self.pending = False
            finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
            if not finite and np.isfinite(before).all():
                self.find("step", "silent NaN", f"the state restored is not finite: {error}")
            return "trouble"
        except GranularError:
            self.counts["refused under way"] += 1
            self.pending = False
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
        announced = (
            bool(self.told)
            or bool(data.warning.number.any())
            or any(
                now > then for now, then in zip(self.counters(), counted or 9 * (0,), strict=False)
            )
        )
        if self.pending and not announced:
            self.find("step", "silent NaN", "the step after does not speak of it either")
            return "trouble"
        self.pending = False
        if not all_finite(data):
            if not announced:
                self.pending = True
            return "announced"
        if self.implicit:
            self.weigh_work(
                "step", model, data, sand_force(self.sand, data), speed, announced, before
            )
        self.watch_rest()
        return "announced" if announced else "fine"

    def inner_step(self, before: np.ndarray, speed: np.ndarray, heard: str | None) -> None:
        """One `mj_step` with the plugin; compared with the other door's."""
        assert self.inside is not None
        data, model = self.inner, self.inside
        must_refuse = self.must_refuse(model, inside=True)
        self.told.clear()
        quiet(data)
        self.place(self.step, 1)
        self.counts["steps inside"] += 1
        try:
            mujoco.mj_step(model, data)
        except mujoco.FatalError as error:
            if "mjgranular" in str(error):
                self.counts["refused under way, inside"] += 1
                expected = must_refuse or doors_may_differ(self.model)
                if heard in ("fine", "announced") and not expected:
                    self.find("plugin", "only one door refuses", str(error))
            else:
                self.fatal("plugin", before, error)
            if heard is None:
                self.recover()
            return
        except Exception as error:
            self.find("plugin", "exception", repr(error))
            return
        bad = bool(data.warning.number[list(_BAD)].any())
        announced = bool(data.warning.number.any()) or bool(self.told)
        if must_refuse and not announced:
            self.find("plugin", f"{must_refuse} without a word", "mj_step goes on")
            if heard is None:
                self.recover()
            return
        if not all_finite(data) and not announced:
            mujoco.mj_step(model, data)  # MuJoCo looks at the beginning of a step
            if not data.warning.number.any():
                self.find("plugin", "silent NaN", "the step after does not speak of it either")
            if heard is None:
                self.recover()
            return
        if heard is None:  # the only door there is
            if bad:
                self.recover()
            else:
                mujoco.mj_setState(self.model, self.data, state_of(self.inside, self.inner), STATE)
            return
        if heard == "refused":
            if not must_refuse and not announced and not self.must_refuse(model, inside=False):
                self.find("step", "only one door refuses", "mj_step goes on")
            return
        if bad != (heard == "trouble"):
            if heard == "fine" or (heard == "trouble" and not announced):
                words = ("finds nothing bad", "finds something bad")
                fastest = float(np.abs(data.qacc).max())
                text = f"Sand.step: {heard}; mj_step {words[bad]}, qacc {fastest:.3g}"
                failed = not doors_may_differ(self.model) and fastest < LEFT_REASON
                self.find("both", "only one door finds it bad", text, failed=failed)
            return
        if heard == "fine" and not announced:
            if self.implicit:
                self.weigh_work(
                    "plugin", model, data, sand_force_inside(data), speed, False, before
                )
            self.compare_doors(speed, before)

    # What is asked of a step

    def compare_doors(self, speed: np.ndarray, before: np.ndarray) -> None:
        """Velocities at the end of the step, in parts of the speeds at hand."""
        assert self.inside is not None
        if doors_may_differ(self.model):
            return
        self.counts["steps compared"] += 1
        apart = float(np.abs(self.data.qvel - self.inner.qvel).max())
        if apart <= 1e-13:
            return
        data = self.data
        h = abs(float(self.model.opt.timestep))
        forces = (data.qfrc_bias, data.qfrc_actuator, data.qfrc_applied, data.qfrc_passive)
        pushed = sum(np.abs(force) for force in forces) / np.maximum(self.model.dof_M0, 1e-9)
        scale = max(
            np.abs(speed).max(), np.abs(data.qvel).max(), h * float(np.linalg.norm(pushed, np.inf))
        )
        if apart <= ALIKE * scale:
            return
        text = f"by {apart:.3g} of {scale:.3g}"
        if apart <= 10.0 * sensitivity(self.inside, self.inner, before, scale / max(h, 1e-12)):
            self.find("both", "doors differ (rounding alone does that)", text, failed=False)
            return
        self.find("both", "doors differ", text, apart / scale)

    def weigh_work(
        self,
        door: str,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        force: np.ndarray,
        speed: np.ndarray,
        announced: bool,
        before: np.ndarray,
    ) -> None:
        """The true work of the sand: with the velocities that the step has ended with [J]."""
        h = float(model.opt.timestep)
        if not (0.0 < h < 1e3) or not np.isfinite(force).all():
            return
        work = h * float(force @ data.qvel)
        self.counts["steps weighed"] += 1
        if door == "step":
            self.sum_work(work, model, data, speed)
        if work <= JOULES:
            return
        kinetic = 0.0
        for v in (speed, data.qvel):
            mujoco.mj_mulM(model, data, self.product, np.ascontiguousarray(v))
            kinetic = max(kinetic, 0.5 * float(v @ self.product))
        impulse = 0.5 * h * h * float((force * force / np.maximum(model.dof_M0, 1e-9)).sum())
        if work <= OF_KINETIC * kinetic + JOULES + OF_IMPULSE * impulse:
            return
        reason = documented(model) or ("counted or warned of" if announced else "")
        missing = "" if reason else self.without_what(before)
        if missing == SOLVER_ENDS and work <= OF_EARLY_END * kinetic:
            reason = "within the tolerance of the engine's solver"
        kind = f"energy ({reason})" if reason else f"energy{missing}"
        if reason:
            self.counts[f"energy, {reason}"] += 1
        self.find(
            door,
            kind,
            f"{work:.3g} J in a step, of {kinetic:.3g} J",
            work / max(kinetic, JOULES),
            failed=not reason,
        )

    def sum_work(
        self, work: float, model: mujoco.MjModel, data: mujoco.MjData, speed: np.ndarray
    ) -> None:
        """Sum the work since the beginning, counted and announced steps included."""
        mujoco.mj_mulM(model, data, self.product, np.ascontiguousarray(speed))
        self.energy = max(self.energy, 0.5 * float(speed @ self.product))
        self.given += work
        if self.given > OF_KINETIC * self.energy + self.step * JOULES and not documented(model):
            text = f"{self.given:.3g} J since step {self.begun}, of {self.energy:.3g} J"
            value = self.given / max(self.energy, JOULES)
            self.find("step", "energy, summed", text, value, failed=self.drawn.kind != "hostile")

    def ask_twins(self) -> None:
        """Ask whether the same thing moves alike however it is described."""
        law, surface, scheme = self.drawn.model.program
        if scheme != "implicit" or self.bare or self.drawn.kind == "rest":
            return
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            for name, off, failed in twins.ask(self.seed, self.number, (law, surface, scheme)):
                self.counts[f"twins: {name}"] += 1
                if failed or (name == "rounding alone" and off > ALIKE):
                    self.find("twins", name, f"{off:.3g} of the speed apart", off, failed)

    def without_what(self, before: np.ndarray) -> str:
        """Tells whether the work is gone with a new Sand, or with an exact solver."""
        if self.asked > 5:
            return ""
        self.asked += 1
        return without_which(self.model, self.drawn.model.sand, before)

    def watch_rest(self) -> None:
        """Tells whether what lies still goes on lying still."""
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
        """The integrator, where it cannot be stepped with this sand."""
        implicit = self.implicit or (self.sand is None and not inside)
        if model.opt.integrator == _RK4 and (implicit or not inside):
            return "RK4"
        other = model.opt.solver == _PGS or model.opt.enableflags & _IPC
        if model.opt.integrator == _DISCRETE and implicit and other:
            return "discrete"
        return ""

    # Around it

    def counters(self) -> tuple[int, ...]:
        """What the scheme counts of its own shortcomings."""
        assert self.sand is not None
        binding = self.sand._bindings.get(self.data)
        if binding is None or binding.workspace.statistics is None:
            return ()
        account = binding.workspace.statistics[0]
        whole = [name for name in account.dtype.names if account.dtype[name] == np.int64]
        return tuple(
            int(account[name]) for name in whole if name not in ("steps", "evaluations", "most")
        )

    def fatal(self, door: str, before: np.ndarray, error: Exception) -> None:
        """An error of MuJoCo's: found only if it is none without sand."""
        for data in (mujoco.MjData(self.model), self.data):
            mujoco.mj_setState(self.model, data, before, STATE)
            try:
                mujoco.mj_step(self.model, data)
            except mujoco.FatalError:
                self.counts["errors of MuJoCo's own"] += 1
                return
        self.find(door, "exception", f"mujoco.FatalError: {error}")

    def recover(self) -> None:
        """Back to the beginning, with the model as it was."""
        self.troubles += 1
        self.begun = self.step + 1
        self.given = self.energy = 0.0
        self.pending = False
        self.original.restore(self.model)
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self.start, STATE)
        if self.sand is not None:
            self.sand.release(self.data)
        if self.inside is not None:
            self.original.restore(self.inside)
            mujoco.mj_resetData(self.inside, self.inner)

    def find(
        self, door: str, kind: str, text: str, value: float = 0.0, failed: bool = True
    ) -> None:
        """Notes a finding; of each kind only the first and the greatest of a model is kept."""
        self.counts[f"found: {kind}"] += 1
        known = next((f for f in self.findings if (f.kind, f.door) == (kind, door)), None)
        if known is not None and value <= known.value:
            return
        opt = self.model.opt
        recent = {
            step: lines
            for step, lines in self.drawn.plan.events.items()
            if step <= self.step and step > self.step - 12
        }
        about = {
            "kind of run": self.drawn.kind,
            "program": " ".join(self.drawn.model.program),
            "timestep": float(opt.timestep),
            "integrator": int(opt.integrator),
            "solver": int(opt.solver),
            "jacobian": int(opt.jacobian),
            "disableflags": int(opt.disableflags),
            "enableflags": int(opt.enableflags),
            "iterations": int(opt.iterations),
            "nv": self.model.nv,
            "nefc": int(self.data.nefc),
            "begun at": self.begun,
            "first step": known.step if known is not None else self.step,
            "recent": recent,
        }
        found = Finding(
            self.seed, self.number, self.step, door, kind, text, float(value), failed, about
        )
        if known is None:
            self.findings.append(found)
        else:
            self.findings[self.findings.index(known)] = found
