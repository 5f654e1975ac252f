"""Random models in random sand: the sand takes energy and gives none, and steps are predicted."""

import math
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

from mjgranular import DepthVelocityLaw, Rft3dLaw, Sand, media
from mjgranular.models import Link

STEPS = 60
BLOB = DepthVelocityLaw(constant=0.3, stiffness=30.0, exponent=1.0, linear=0.1, quadratic=2.0)
SANDS = (
    {"law": "link"},
    {"law": "link_distributed"},
    {"law": "rft2d", "medium": "poppy_seed_loose", "resolution": 4},
    {"law": "rft3d", "medium": "quikrete_medium", "resolution": 4},
    {"law": BLOB},
)
TIMESTEPS = (1e-4, 1e-3, 2e-3, 5e-3, 1e-2)
INTEGRATORS = ("Euler", "implicit", "implicitfast")
SHAPES = ("capsule", "cylinder", "box", "sphere", "ellipsoid")
RODS = SHAPES[:2]


def numbers(values):
    return " ".join(f"{value:.4g}" for value in values)


@dataclass
class Drawn:
    """A model of one tree with joints or of one or two loose bodies, drawn; its sand."""

    seed: int
    contacts: bool = True
    limits: bool = True
    integrator: str = ""  # drawn too, if none is given

    def __post_init__(self):
        self.rng = rng = np.random.default_rng(self.seed)
        self.sand = SANDS[self.seed % len(SANDS)]
        self.shapes = RODS if str(self.sand["law"]).startswith("link") else SHAPES
        self.timestep, integrator = rng.choice(TIMESTEPS), rng.choice(INTEGRATORS)
        self.integrator = self.integrator or integrator
        self.damping = rng.choice([0, 0, 0.01, 0.3])
        tree = rng.random() < 0.7
        loose = 1 if tree else rng.integers(1, 3)
        bodies = "".join(
            f'<body pos="{0.5 * i} 0 {rng.uniform(-0.1, 0.15):.4g}" quat="{self.turn()}">'
            f"<freejoint/>{self.geom()}{self.limb(0) if tree else ''}</body>"
            for i in range(loose)
        )
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{self.timestep}" integrator="{self.integrator}" '
            f'cone="{rng.choice(["pyramidal", "elliptic"])}"/>'
            f"<worldbody>{bodies}</worldbody></mujoco>"
        )

    def turn(self):
        return numbers(self.rng.normal(size=4))

    def geom(self):
        touches = int(self.contacts and self.rng.random() < 0.3)
        return (
            f'<geom type="{self.rng.choice(self.shapes)}" quat="{self.turn()}" '
            f'size="{numbers(self.rng.uniform(0.02, 0.08, 3))}" '
            f'density="{self.rng.uniform(300, 3000):.4g}" contype="1" conaffinity="{touches}"/>'
        )

    def limb(self, level):
        rng = self.rng
        ball, limited = rng.random() < 0.2, self.limits and rng.random() < 0.5
        reach = ("0 50" if ball else "-40 40") if limited else "0 0"
        joint = (
            f'<joint type="{"ball" if ball else "hinge"}" axis="{numbers(rng.normal(size=3))}" '
            f'limited="{str(limited).lower()}" range="{reach}" damping="{self.damping}" '
            f'armature="{rng.choice([0, 0.01])}"/>'
        )
        more = "".join(
            self.limb(level + 1) for chance in (0.6, 0.4) if level < 3 and rng.random() < chance
        )
        pos = numbers(rng.normal(scale=0.08, size=3))
        return f'<body pos="{pos}">{joint}{self.geom()}{more}</body>'

    def begin(self):
        """The sand, and a simulation in motion."""
        sand, data = Sand(self.model, scheme="implicit", **self.sand), mujoco.MjData(self.model)
        data.qvel[:] = self.rng.normal(size=self.model.nv) * self.rng.choice([0, 0.1, 1, 5])
        return sand, data


def step(sand, data):
    """One step; the work of the sand in it, with the velocities at its end [J]."""
    model = sand.model
    mujoco.mj_step1(model, data)
    own = data.xfrc_applied.copy()
    sand.apply(data)
    work = []
    for body in np.unique(sand.elements["body"]):
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, linear, angular, body)
        wrench = data.xfrc_applied[body] - own[body]
        work.append((linear, angular, wrench))
    mujoco.mj_step2(model, data)
    data.xfrc_applied[:] = own
    return model.opt.timestep * sum(
        wrench[:3] @ (linear @ data.qvel) + wrench[3:] @ (angular @ data.qvel)
        for linear, angular, wrench in work
    )


@pytest.mark.parametrize(
    ("seed", "integrator"),
    [*((seed, "") for seed in range(30)), *((seed, "discrete") for seed in range(1000, 1018))],
)
def test_the_sand_takes_energy_and_gives_none(seed, integrator):
    drawn = Drawn(seed, integrator=integrator)
    sand, data = drawn.begin()
    # Measured over 1,000 models of this kind: see docs/scheme.md.
    assert max(step(sand, data) for _ in range(STEPS)) <= 1e-12
    assert np.isfinite(data.qpos).all()


@pytest.mark.parametrize("seed", range(100, 112))
def test_a_step_in_sand_ends_with_less_than_one_without(seed):
    # In the norm of A, which is M plus the integrator's damping: with A (v' - v_free) = p,
    # |v'|^2 - |v_free|^2 = 2 p v' - |v' - v_free|^2, and p v' is the work of the sand.
    drawn = Drawn(seed, contacts=False, limits=False)
    drawn.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    model = drawn.model
    sand, data = drawn.begin()
    bare, inertia = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    for _ in range(STEPS):
        mujoco.mj_copyData(bare, model, data)
        mujoco.mj_step(model, bare)
        sand.step(data)
        mujoco.mj_fullM(model, data, inertia)
        inertia[np.diag_indices(model.nv)] += model.opt.timestep * model.dof_damping
        with_sand, without = (0.5 * v @ inertia @ v for v in (data.qvel, bare.qvel))
        assert with_sand <= without * (1 + 1e-9) + 1e-12


@pytest.mark.parametrize("seed", range(200, 212))
@pytest.mark.parametrize("integrator", ["", "discrete"])
def test_random_steps_are_predicted(seed, integrator):
    drawn = Drawn(seed, contacts=False, integrator=integrator)
    drawn.model.opt.tolerance, drawn.model.opt.iterations = 1e-15, 200
    sand, data = drawn.begin()
    account = None
    for _ in range(STEPS):
        data.qfrc_applied[:] = drawn.rng.normal(scale=0.1, size=drawn.model.nv)
        before = data.qvel.copy()
        sand.step(data)
        workspace = sand._bindings[data].workspace
        account = workspace.statistics[0]
        if not (sand._bindings[data].contacts["depth"] > 0).any() or account["residual"] > 1e-10:
            continue
        found = workspace.arrays["velocity"]
        speed = max(9.81 * drawn.timestep, abs(data.qvel).max(), abs(data.qvel - before).max())
        # Light chains: what a residual of 1e-11 of the momentum at hand is for the lightest.
        assert abs(data.qvel - found).max() <= 1e-7 * speed
    assert account["unfinished"] <= 0.1 * STEPS


def test_next_to_no_random_step_is_left_unfinished():
    # Which ones are is a matter of rounding: 24 and 29 of 10,883 in two versions that agree
    # otherwise, up to 6 of 60 in one model.
    steps = unfinished = 0
    for seed in range(200, 300):
        drawn = Drawn(seed, contacts=False)
        drawn.model.opt.tolerance, drawn.model.opt.iterations = 0, 200
        sand, data = drawn.begin()
        for _ in range(STEPS):
            data.qfrc_applied[:] = drawn.rng.normal(scale=0.1, size=drawn.model.nv)
            sand.step(data)
        solver = sand.report(data).solver
        steps, unfinished = steps + solver.steps, unfinished + solver.unfinished
    assert steps > 4000
    assert unfinished <= 0.005 * steps


@pytest.mark.parametrize("seed", [5025, 5090, 5135, 5276, 5415, 5800])
def test_what_is_set_off_from_rest_is_solved(seed):
    # Rods: the speeds of the step's end, with their rounding, are not those of its beginning.
    sand, data = Drawn(seed).begin()
    sand.step(data)
    solver = sand.report(data).solver
    assert solver.steps >= 1
    assert solver.unfinished == 0


# Where Euler's own error is known


FALLING = (
    ("capsule", {"law": "link"}),
    ("capsule", {"law": "link_distributed"}),
    ("box", {"law": "rft2d", "medium": "poppy_seed_loose"}),
    ("box", {"law": "rft3d", "medium": "quikrete_medium"}),
    ("ellipsoid", {"law": Rft3dLaw.from_medium(media["quikrete_medium"])}),
    ("sphere", {"law": BLOB}),
)
SLIDES = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))


def energy(model, data):
    """Kinetic, and of the height; for slides, whose inertia does not change [J]."""
    mass = model.body_mass[1]
    return 0.5 * mass * data.qvel @ data.qvel + 9.81 * mass * data.qpos[2]


@pytest.mark.parametrize("timestep", [TIMESTEPS[1], TIMESTEPS[-1]])
@pytest.mark.parametrize(("shape", "options"), FALLING, ids=lambda value: str(value)[:40])
def test_energy_never_grows_in_translation(shape, options, timestep):
    # There E' - E = W - |v' - v|^2/2 in the norm of M: the sand's work and a loss of Euler's.
    rng = np.random.default_rng(0)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{timestep}"/><worldbody><body>{SLIDES}'
        f'<geom type="{shape}" size=".03 .08 .05" quat="{numbers(rng.normal(size=4))}"/>'
        "</body></worldbody></mujoco>"
    )
    sand, data = Sand(model, scheme="implicit", **options), mujoco.MjData(model)
    data.qpos[2], data.qvel[:] = 0.05, [2.0, -1.0, -4.0]
    before = energy(model, data)
    for _ in range(300):
        sand.step(data)
        now = energy(model, data)
        assert now <= before + 1e-12
        before = now
    assert abs(data.qvel).max() < 1e-6


@pytest.mark.parametrize("law", ["link", "link_distributed"])
@pytest.mark.parametrize("timestep", [TIMESTEPS[1], TIMESTEPS[-1]])
@pytest.mark.parametrize("angle", [0, 60, 85])
def test_energy_of_the_link_never_grows(law, timestep, angle):
    # Its inertia does not change either: x and z of C and an angle.
    link, q = Link(), math.radians(angle)
    model = link.model(timestep)
    sand, data = Sand(model, law=law, scheme="implicit", bodies="link"), mujoco.MjData(model)
    data.qpos[:] = link.touching(q)
    data.qvel[:] = link.moving(q, 10.0, 0.5, 3.0)

    def total():
        vx, vz, omega = data.qvel
        kinetic = 0.5 * link.mass * (vx**2 + vz**2) + 0.5 * link.inertia * omega**2
        return kinetic + 9.81 * link.mass * data.qpos[1]

    before = total()
    for _ in range(300):
        sand.step(data)
        now = total()
        assert now <= before + 1e-12
        before = now
