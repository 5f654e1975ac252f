"""Draw random models with random sand: all joints, bodies and forces of MJCF.

A model depends only on a seed and a number.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np
from attacks.cases import ModelCase

SHAPES = ("capsule", "sphere", "box", "cylinder", "ellipsoid", "mesh")
RODS = ("capsule", "cylinder")
INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4", "discrete")
TIMESTEPS = (1e-5, 1e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)

# Arguments of `Sand`, as they would be written.
LAWS = {
    "link": ("medium='play_sand', law='link'",),
    "link_distributed": (
        "medium='play_sand', law='link_distributed'",
        "law=DistributedLinkLaw(eta_d=3.0, eta_h=20.0, eta_v=50.0, exponent=1.3, pieces=7)",
    ),
    "rft2d": (
        "medium='poppy_seed_loose', law='rft2d', resolution=4",
        "medium='glass_beads', law='rft2d', resolution=3",
    ),
    "rft3d": ("medium='quikrete_medium', law='rft3d', resolution=4",),
    "rft2d_dynamic": ("medium='poppy_seed_loose', law='rft2d_dynamic', resolution=4",),
    "rft3d_dynamic": ("medium='quikrete_medium', law='rft3d_dynamic', resolution=4",),
    "depth_velocity": (
        "law=DepthVelocityLaw(constant=0.3, stiffness=30.0, linear=0.1, quadratic=2.0)",
        "law=DepthVelocityLaw(stiffness=300.0, exponent=1.5, linear=3.0)",
    ),
}
SURFACES = ("plane", "bed", "height_field")
SCHEMES = ("implicit", "explicit")
MOVING = ("rft2d_dynamic", "rft3d_dynamic")  # sand; the explicit scheme has no acceleration
PROGRAMS = (
    *(
        (law, surface, scheme)
        for scheme in SCHEMES
        for surface in SURFACES
        for law in LAWS
        if scheme == "implicit" or law not in MOVING
    ),
    *((law, "plane memory", "implicit") for law in LAWS),
    *(("rft3d_dynamic", f"{surface} memory", "implicit") for surface in SURFACES[1:]),
    ("rft3d", "plane memory", "explicit"),
)
"""Laws, surfaces and schemes: each combination is compiled once on a machine."""
SHORT = (
    *((law, "plane", scheme) for law in ("link_distributed", "rft3d") for scheme in SCHEMES),
    *(("rft3d_dynamic", surface, "implicit") for surface in ("plane", "plane memory")),
    ("rft3d", "height_field", "implicit"),
    ("link", "bed", "implicit"),
)
"""Some of them, for tests."""
CELLS = (0.005, 0.01, 0.02)


def draw(rng: np.random.Generator, program: tuple[str, str, str], number: int = 0) -> ModelCase:
    """Draw a model that MuJoCo can compile, for a law, a surface and a scheme."""
    while True:
        xml, sand = Draft(rng, program).finish()
        try:
            model = mujoco.MjModel.from_xml_string(xml)
        except ValueError:  # an impossible inertia or equality
            continue
        if model.nv and np.isfinite(model.body_mass).all():
            return ModelCase(xml, sand, program, number)


def draw_at_rest(rng: np.random.Generator, program: tuple[str, str, str], number: int) -> ModelCase:
    """Draw free bodies that lie side by side in sand, optionally on a floor under it."""
    law, _, scheme = program
    draft = Draft(rng, program)
    timestep = rng.choice(TIMESTEPS[4:7])
    for row in range(rng.integers(1, 13)):
        shape = rng.choice(RODS if law.startswith("link") else SHAPES[:5])
        draft.geoms.append(f"g{row}")
        draft.bodies.append(
            f'<body pos="{0.3 * row:g} 0 -0.02" quat="{draft.turn()}"><freejoint/>'
            f'<geom name="g{row}" type="{shape}" size="{draft.numbers(0.04, 0.09, 3)}" '
            f'density="{rng.uniform(300, 2500):.4g}"/></body>'
        )
    option = (
        f'<option timestep="{timestep}" integrator="{rng.choice(INTEGRATORS[:3])}" '
        f'jacobian="{rng.choice(["dense", "sparse", "auto"])}"/>'
    )
    floor = '<geom type="plane" size="9 9 0.1" pos="0 0 -0.08"/>' if draft.chance(0.5) else ""
    xml = f"<mujoco>{option}<worldbody>{floor}{''.join(draft.bodies)}</worldbody></mujoco>"
    sand = f"{LAWS[law][0]}, scheme='{scheme}'"
    return ModelCase(xml, sand, (law, "plane", scheme), number)


def draw_twin(
    rng: np.random.Generator, program: tuple[str, str, str], shape: str = ""
) -> tuple[mujoco.MjSpec, str]:
    """Draw a free body with limbs that only sand acts on, or one geom, and its sand."""
    while True:
        draft = Draft(rng, program)
        place, sand_geom = draft.place(program[1])
        where = f'pos="0 0 {rng.uniform(-0.1, 0):.3g}" quat="{draft.turn()}"'
        body = draft.body(0 if not shape else 9, "<freejoint/>", where)
        if shape:
            body = f'<body name="b0" {where}><freejoint/><geom name="g0" type="{shape}" '
            body += f'size="{draft.numbers(0.02, 0.06, 3)}"/></body>'
        spec = mujoco.MjSpec.from_string(
            f"<mujoco><option><flag contact='disable'/></option>{draft.assets(sand_geom)}"
            f"<worldbody>{sand_geom}{body}</worldbody></mujoco>"
        )
        for joint in spec.joints:
            joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE
            joint.stiffness[:], joint.damping[:], joint.frictionloss, joint.armature = 0, 0, 0, 0
        try:
            spec.copy().compile()
        except ValueError:  # an impossible inertia
            continue
        chosen = f", geoms={draft.geoms}" if program[0].startswith("link") else ""
        return spec, draft.sand(place) + chosen


@dataclass
class Draft:
    """Parts of a model that is being drawn."""

    rng: np.random.Generator
    program: tuple[str, str, str]
    bodies: list[str] = field(default_factory=list)
    geoms: list[str] = field(default_factory=list)  # geoms that can meet the sand
    dry: int = 0  # other geoms
    joints: list[tuple[str, str]] = field(default_factory=list)  # name and type
    sites: list[str] = field(default_factory=list)
    names: list[str] = field(default_factory=list)  # of bodies
    mocaps: list[str] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    cords: list[str] = field(default_factory=list)  # tendons

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def numbers(self, low: float, high: float, count: int) -> str:
        return " ".join(f"{x:.4g}" for x in self.rng.uniform(low, high, count))

    def maybe(self, probability: float, name: str, low: float, high: float) -> str:
        """Return an attribute with a power of ten, or nothing."""
        if not self.chance(probability):
            return ""
        return f' {name}="{10 ** self.rng.uniform(low, high):.3g}"'

    def turn(self, count: int = 4) -> str:
        return " ".join(f"{x:.4g}" for x in self.rng.normal(size=count))

    # The whole model

    def finish(self) -> tuple[str, str]:
        """Draw all parts; return the model in MJCF and the arguments of `Sand`."""
        rng, (law, surface, scheme) = self.rng, self.program
        fine = scheme == "explicit" and self.chance(0.8)
        timestep = float(rng.choice(TIMESTEPS[:3] if fine else TIMESTEPS))
        integrator = str(
            rng.choice(INTEGRATORS, p=(0.3, 0.25, 0.35, 0.06, 0.04))
            if hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE")
            else rng.choice(INTEGRATORS[:4], p=(0.3, 0.3, 0.35, 0.05))
        )
        trees = "".join(self.tree(number) for number in range(rng.integers(1, 5)))
        place, sand_geom = self.place(surface)
        parts = [self.equalities(), self.tendons()]
        xml = (
            f"<mujoco>{self.option(timestep, integrator)}{self.assets(sand_geom)}"
            f"<worldbody>{sand_geom}{self.floor()}{trees}</worldbody>"
            f"{''.join(parts)}{self.actuators()}</mujoco>"
        )
        sand = self.sand(place)
        if law.startswith("link") or self.chance(0.2):
            chosen = [name for name in self.geoms if self.chance(0.9)] or self.geoms[:1]
            sand += f", geoms={chosen}"
        return xml, sand

    def sand(self, place: str) -> str:
        """Return arguments of `Sand`."""
        law, surface, scheme = self.program
        sand = str(self.rng.choice(LAWS[law]))
        if "memory" in surface:
            sand += f", memory=Memory(cell={self.rng.choice(CELLS)}, extent=2.8)"
        scheme = "auto" if self.chance(0.1) and law not in MOVING else scheme
        return f"{sand}, surface={place}, scheme='{scheme}'"

    def option(self, timestep: float, integrator: str) -> str:
        rng = self.rng
        gravity = {0: "0 0 0", 1: self.numbers(-9, 9, 3), 2: "0 0 -300"}.get(
            int(rng.choice(4, p=(0.08, 0.2, 0.02, 0.7))), "0 0 -9.81"
        )
        words = [
            f'timestep="{timestep}" integrator="{integrator}" gravity="{gravity}"',
            f'cone="{rng.choice(["pyramidal", "elliptic"])}"',
            f'solver="{rng.choice(["PGS", "CG", "Newton"], p=(0.2, 0.2, 0.6))}"',
            f'jacobian="{rng.choice(["dense", "sparse", "auto"])}"',
        ]
        for chance, name, values in (
            (0.08, "iterations", [1, 2, 10]),
            (0.1, "tolerance", ["0", "1e-4", "1e-12"]),
            (0.06, "noslip_iterations", [1, 2, 3, 4, 5]),
        ):
            if self.chance(chance):
                words.append(f'{name}="{rng.choice(values)}"')
        if self.chance(0.15):
            words.append(f'density="{rng.choice([1.2, 1000])}" viscosity="{rng.choice([0, 1e-3])}"')
            words.append(f'wind="{self.numbers(-3, 3, 3)}"')
        if self.chance(0.1):
            words.append(f'impratio="{rng.choice([0.1, 10, 100])}"')
        flags = [
            f'{name}="{value}"'
            for chance, value, names in (
                (0.2, "disable", ["eulerdamp"]),
                (0.1, "enable", ["sleep"]),
                (0.05, "disable", ["warmstart", "refsafe", "island"]),
                (0.05, "disable", ["autoreset", "filterparent", "midphase"]),
                (0.04, "enable", ["energy", "fwdinv", "invdiscrete"]),
            )
            for name in names
            if self.chance(chance)
        ]
        return f"<option {' '.join(words)}><flag {' '.join(flags)}/></option>"

    def assets(self, sand_geom: str) -> str:
        rows = "".join(self.meshes)
        if "hfield" in sand_geom:
            size = f"{self.numbers(0.6, 1.5, 2)} {self.numbers(0.01, 0.15, 1)} 0.1"
            # Many heights, so that a read beyond them hits unmapped memory.
            grid = f'nrow="5" ncol="7" elevation="{self.numbers(0, 1, 35)}"'
            if self.chance(0.1):
                grid = 'nrow="1200" ncol="1200"'
            rows += f'<hfield name="dunes" size="{size}" {grid}/>'
        return f"<asset>{rows}</asset>"

    def place(self, surface: str) -> tuple[str, str]:
        """Return the surface as a string, and its geom."""
        tilt = f"1 {self.rng.normal(scale=0.08):.3g} {self.rng.normal(scale=0.08):.3g} 0"
        if surface.startswith("bed"):
            return "Bed('tray')", (
                f'<geom name="tray" type="box" size="1 1 0.2" pos="0 0 -0.2" quat="{tilt}"/>'
            )
        if surface.startswith("height_field"):
            return "HeightField('dunes')", (
                '<geom name="dunes" type="hfield" hfield="dunes" pos="0 0 -0.05" '
                f'quat="{tilt if self.chance(0.5) else "1 0 0 0"}"/>'
            )
        if self.chance(0.5):
            return "None", ""
        height, slope = self.rng.uniform(-0.05, 0.1), self.rng.uniform(-0.4, 0.4)
        return f"Plane(height={height:.3g}, slope={slope:.3g}, uphill=1.0)", ""

    def floor(self) -> str:
        if not self.chance(0.35):
            return ""
        return f'<geom type="plane" size="9 9 0.1" pos="0 0 {self.rng.uniform(-0.3, -0.05):.3g}"/>'

    # Bodies

    def tree(self, number: int) -> str:
        rng = self.rng
        pos = (
            f"{0.25 * number - 0.3:.3g} {rng.normal(scale=0.1):.3g} {rng.uniform(-0.12, 0.15):.3g}"
        )
        kind = rng.choice(["free", "fixed", "stack", "ball", "mocap"], p=(0.5, 0.1, 0.2, 0.1, 0.1))
        if kind == "mocap":
            name = f"m{len(self.mocaps)}"
            self.mocaps.append(name)
            return (
                f'<body name="{name}" mocap="true" pos="{pos}">{self.body(1, self.joint())}</body>'
            )
        if kind == "free":
            joints = '<freejoint align="false"/>' if self.chance(0.7) else "<freejoint/>"
        elif kind == "stack":
            kinds = [str(rng.choice(["slide", "hinge"])) for _ in range(rng.integers(2, 5))]
            joints = "".join(self.joint(kind) for kind in kinds)
        else:
            joints = self.joint("ball" if kind == "ball" else "")
        return self.body(0, joints, f'pos="{pos}" quat="{self.turn()}"')

    def body(self, level: int, joints: str, where: str = "") -> str:
        rng = self.rng
        name = f"b{len(self.names)}"
        self.names.append(name)
        skin = self.geom(first=not self.geoms or self.chance(0.7))
        if self.chance(0.25):
            skin += self.geom()
        if self.chance(0.4):
            self.sites.append(f"s{len(self.sites)}")
            skin += f'<site name="{self.sites[-1]}" pos="{self.numbers(-0.05, 0.05, 3)}"/>'
        limbs = ""
        for chance in (0.6, 0.3):
            if level < 4 and self.chance(chance):
                where = f'pos="{self.numbers(-0.1, 0.1, 3)}" quat="{self.turn()}"'
                limbs += self.body(level + 1, self.limb_joints(), where)
        caught = f'gravcomp="{rng.uniform(0, 1.5):.2g}"' if self.chance(0.05) else ""
        return f'<body name="{name}" {where} {caught}>{joints}{self.inertial()}{skin}{limbs}</body>'

    def limb_joints(self) -> str:
        if self.chance(0.15):
            return ""  # welded to its parent
        if self.chance(0.2):
            return self.joint("slide") + self.joint("hinge")
        return self.joint()

    def inertial(self) -> str:
        """Return an inertia off the origin and rotated, or nothing, for that of the geoms."""
        if not self.chance(0.35):
            return ""
        rng = self.rng
        mass = 10 ** rng.uniform(-2.5, 0.8)
        a, b, c = (rng.uniform(0.01, 0.15, 3)) ** 2
        moments = " ".join(f"{mass * x:.6g}" for x in (b + c, a + c, a + b))
        return (
            f'<inertial mass="{mass:.4g}" pos="{self.numbers(-0.12, 0.12, 3)}" '
            f'quat="{self.turn()}" diaginertia="{moments}"/>'
        )

    def geom(self, *, first: bool = False) -> str:
        rng = self.rng
        rods_only = self.program[0].startswith("link")
        shape = str(rng.choice(RODS if rods_only and first else SHAPES))
        if shape in RODS or not rods_only:
            name = f"g{len(self.geoms)}"
            self.geoms.append(name)
        else:
            name = f"dry{self.dry}"
            self.dry += 1
        what = f'size="{self.numbers(0.02, 0.08, 3)}"'
        if shape == "mesh":
            number = len(self.meshes)
            what = f'mesh="mesh{number}"'
            corners = self.numbers(-0.08, 0.08, 3 * int(rng.integers(4, 9)))
            self.meshes.append(f'<mesh name="mesh{number}" vertex="{corners}"/>')
        pos = self.numbers(-0.1, 0.1, 3) if self.chance(0.3) else "0 0 0"
        if shape == "box" and not rods_only and self.chance(0.4):
            return self.pieces(name)
        touches = int(self.chance(0.4))
        dims = rng.choice([1, 3, 4, 6], p=(0.1, 0.6, 0.15, 0.15))
        return (
            f'<geom name="{name}" type="{shape}" {what} pos="{pos}" quat="{self.turn()}" '
            f'density="{10 ** rng.uniform(2, 3.7):.4g}" contype="1" conaffinity="{touches}" '
            f'condim="{dims}" friction="{self.numbers(0.1, 1.5, 1)} 0.01 0.001"/>'
        )

    def pieces(self, name: str) -> str:
        """Draw a bar in pieces, with gaps or without."""
        count, half = int(self.rng.integers(2, 9)), self.rng.uniform(0.01, 0.03, 3)
        pitch = 2.0 * half[0] + self.rng.choice([0.0, 1e-6, 5e-4])
        self.geoms += [f"{name}_{k}" for k in range(1, count)]
        return "".join(
            f'<geom name="{name}{f"_{k}" if k else ""}" type="box" pos="{k * pitch:.7g} 0 0" '
            f'size="{half[0]:.4g} {half[1]:.4g} {half[2]:.4g}" contype="1" conaffinity="0"/>'
            for k in range(count)
        )

    def joint(self, kind: str = "") -> str:
        rng = self.rng
        kind = kind or str(rng.choice(["hinge", "slide", "ball"], p=(0.6, 0.2, 0.2)))
        name = f"j{len(self.joints)}"
        self.joints.append((name, kind))
        words = [f'name="{name}" type="{kind}" pos="{self.numbers(-0.04, 0.04, 3)}"']
        if kind != "ball":
            words.append(f'axis="{self.turn(3)}"')
        if self.chance(0.35):
            reach = {"ball": "0 50", "hinge": "-40 40", "slide": "-0.1 0.1"}[kind]
            words.append(f'limited="true" range="{reach}" margin="{rng.choice([0, 0.01])}"')
        else:
            words.append('limited="false"')
        more = self.maybe(0.25, "stiffness", -1, 3) + self.maybe(0.35, "damping", -3, 1)
        more += self.maybe(0.2, "frictionloss", -3, 0.5) + self.maybe(0.3, "armature", -4, 0)
        return f"<joint {' '.join(words)}{more}/>"

    # Constraints, tendons and actuators

    def equalities(self) -> str:
        rows, rng = "", self.rng
        scalars = [name for name, kind in self.joints if kind != "ball"]
        if len(self.names) > 1 and self.chance(0.2):
            first, second = rng.choice(self.names, 2, replace=False)
            if self.chance(0.5):
                rows += f'<connect body1="{first}" body2="{second}" anchor="0 0 0.05"/>'
            else:
                rows += f'<weld body1="{first}" body2="{second}"/>'
        if self.mocaps and self.chance(0.5):
            rows += f'<weld body1="{self.mocaps[0]}" body2="{rng.choice(self.names)}"/>'
        if self.chance(0.15):
            rows += f'<connect body1="{rng.choice(self.names)}" anchor="0.02 0 0"/>'
        if len(scalars) > 1 and self.chance(0.2):
            first, second = rng.choice(scalars, 2, replace=False)
            rows += f'<joint joint1="{first}" joint2="{second}" polycoef="0 0.5 0 0 0"/>'
        return f"<equality>{rows}</equality>"

    def tendons(self) -> str:
        rows, rng = "", self.rng
        scalars = [name for name, kind in self.joints if kind != "ball"]
        more = self.maybe(0.5, "stiffness", -1, 2) + self.maybe(0.5, "damping", -3, 0.5)
        more += self.maybe(0.3, "frictionloss", -3, 0)
        if self.chance(0.3):
            more += ' limited="true" range="0 0.3"'
        if self.chance(0.2):
            more += ' armature="0.01"'
        if len(scalars) > 1 and self.chance(0.2):
            chosen = rng.choice(scalars, 2, replace=False)
            ends = "".join(f'<joint joint="{name}" coef="{rng.normal():.3g}"/>' for name in chosen)
            rows += f'<fixed name="t0"{more}>{ends}</fixed>'
        if len(self.sites) > 1 and self.chance(0.25):
            first, second = rng.choice(self.sites, 2, replace=False)
            rows += (
                f'<spatial name="t1"{more}><site site="{first}"/><site site="{second}"/></spatial>'
            )
        self.cords += [name for name in ("t0", "t1") if f'"{name}"' in rows]
        return f"<tendon>{rows}</tendon>"

    def actuators(self) -> str:
        rng, rows = self.rng, ""
        targets = [f'joint="{name}"' for name, kind in self.joints if kind != "ball"]
        targets = [target for target in targets if self.chance(0.4)]
        targets += [f'tendon="{name}"' for name in self.cords if self.chance(0.5)]
        for target in targets:
            kind = rng.choice(["motor", "position", "velocity", "intvelocity", "general", "damper"])
            size = 10 ** rng.uniform(-1, 1.7)
            words = {
                "motor": f'gear="{size / 10:.3g}"',
                "position": f'kp="{size:.3g}" kv="{size / 20:.3g}"'
                + (' timeconst="0.02"' if self.chance(0.2) else ""),
                "velocity": f'kv="{size / 10:.3g}"',
                "intvelocity": f'kp="{size:.3g}" actrange="-1 1"',
                "general": f'dyntype="{rng.choice(["filter", "filterexact", "integrator"])}" '
                f'dynprm="0.03" gainprm="{size:.3g}" biastype="affine" '
                f'biasprm="0 {-size:.3g} {-size / 20:.3g}"',
                "damper": f'kv="{size / 20:.3g}" ctrlrange="0 2"',
            }[str(kind)]
            if kind != "damper" and self.chance(0.3):
                words += ' ctrllimited="true" ctrlrange="-1 1"'
            if self.chance(0.2):
                words += ' forcelimited="true" forcerange="-5 5"'
            rows += f"<{kind} {target} {words}/>"
        if self.sites and self.chance(0.1):
            rows += f'<motor site="{self.sites[0]}" gear="0 0 1 0 0.1 0"/>'
        return f"<actuator>{rows}</actuator>"
