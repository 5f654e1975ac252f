"""Build what a simulation needs from a model and a `SandSpec`, with all checks.

`choose_sand` is the half that needs no scheme: it resolves what a sand names in a model.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from mjgranular._util.checks import check_records
from mjgranular.errors import CostWarning, GranularWarning, InputError
from mjgranular.kernel.compiled import program_addresses
from mjgranular.law import Law, make_scene
from mjgranular.law.kernel import LawKernel
from mjgranular.law.law import check_rules
from mjgranular.medium import Medium
from mjgranular.relief.footprint import Footprint, fitting, footprint_of, surroundings_of
from mjgranular.relief.memory import Memory, as_memory
from mjgranular.relief.relief import Relief
from mjgranular.relief.update import update_program
from mjgranular.sand import advice
from mjgranular.sand.spec import SandSpec, combined, material_of
from mjgranular.scheme import Scheme, get_scheme
from mjgranular.scheme.scheme import FORCES, STEP
from mjgranular.shape import select_geoms
from mjgranular.surface import Surface
from mjgranular.surface.place import replace_geoms
from mjgranular.surface.surface import check_surface, surface_of


@dataclass(frozen=True, kw_only=True)
class ChosenSand:
    """The material, the surface and the elements of a sand."""

    medium: Medium
    law: Law  # with its constants
    surface: Surface  # here without memory
    geoms: tuple[int, ...]  # ids of those that meet the sand
    elements: np.ndarray  # of the law, structured, sorted by body
    replaced: tuple[int, ...]  # ids of the geoms that the sand replaces


def choose_sand(model: mujoco.MjModel, spec: SandSpec) -> ChosenSand:
    """Resolve what a sand names in a model, with all checks and warnings.

    Contacts of geoms that the sand replaces are switched off in the model.
    """
    surface = surface_of(spec.surface)
    check_surface(surface, model)
    geoms = geoms_in_sand(model, spec)
    medium, law = material_of(model, spec)
    replaced = replace_geoms(model, spec.instead_of)
    case = advice.Case(model, spec, geoms, law, surface, as_memory(spec.memory))
    advice.warn(advice.CHECKS, case)
    elements = law.elements(model, geoms, spec.resolution)
    check_records(f"{type(law).__name__}.elements", elements, "geom", "body", "slot", "width")
    advice.warn([(advice.link_law, GranularWarning)], case)
    return ChosenSand(
        medium=medium,
        law=law,
        surface=surface,
        geoms=tuple(geoms),
        elements=elements,
        replaced=tuple(replaced),
    )


def geoms_in_sand(model: mujoco.MjModel, spec: SandSpec) -> list[int]:
    """Return the ids of the geoms of a model that meet a sand; see `select_geoms`."""
    return select_geoms(
        model,
        bodies=spec.bodies,
        geoms=spec.geoms,
        groups=spec.groups,
        leave_out=surface_of(spec.surface).geoms(model),
    )


def remembering(
    model: mujoco.MjModel, chosen: ChosenSand, memory: Memory
) -> tuple[Relief, Footprint]:
    """Return the surface of a sand with that memory, and the skin of its bodies."""
    surface, geoms = chosen.surface, list(chosen.geoms)
    relief = Relief(surface, memory, surroundings_of(model, geoms, memory))
    return relief, footprint_of(model, geoms, chosen.elements, memory.cell)


@dataclass(frozen=True, kw_only=True)
class PreparedSand(ChosenSand):
    """A sand that fits a model, with its memory."""

    scheme: Scheme  # the one that acts, also where "auto" was given
    packed: np.ndarray  # the elements as the program reads them
    scene: np.ndarray  # parameters of law and surface, shape (1,)
    kernel: LawKernel  # of the law under this surface
    program: int  # address of the scheme's compiled program (`Scheme.program`)
    sampling: int  # address of `Scheme.sampling`; 0 if that is part of the scheme's program
    forces: int  # address of `Scheme.forces`; 0 if those are
    footprint: Footprint | None  # the skin by which bodies press sand down; None without memory
    update: int  # address of the program that updates the memory; 0 without memory
    disabled: tuple[int, ...]  # ids of geoms whose contacts are off: the sand, what it replaces


def prepare(model: mujoco.MjModel, spec: SandSpec, *, within: bool = False) -> PreparedSand:
    """Prepare a sand for a model, in which contacts of the sand's own geoms are switched off.

    `within` is whether the sand acts inside `mj_step`.
    """
    scheme = get_scheme(spec.scheme)
    scheme.check(model)
    chosen = choose_sand(model, spec)
    law, surface, elements = chosen.law, chosen.surface, chosen.elements
    scheme = scheme.scheme_for(model, len(elements), law.adds_mass)
    scheme.check(model)
    memory, footprint = as_memory(spec.memory), None
    if memory is not None:
        # Within `mj_step` its size was fixed before there was a model (`fitted`).
        memory = memory if within else fitting(model, chosen.geoms, memory)
        surface, footprint = remembering(model, chosen, memory)
    advice.warn([(advice.cost, CostWarning)], elements)
    scene = make_scene(law, chosen.medium, surface, model)
    if footprint is not None:
        scene["surface"]["points"] = footprint.points.ctypes.data
        scene["surface"]["spheres"] = footprint.spheres.ctypes.data
        scene["surface"]["feet"] = footprint.feet.ctypes.data
        scene["surface"]["foot_count"] = len(footprint.feet)
    kernel = law.kernel(surface)
    if not isinstance(kernel, LawKernel):
        raise InputError(f"{type(law).__name__}.kernel must return a LawKernel, not {kernel!r}")
    packed = kernel.pack(elements)
    law_name, scheme_name = f"law {law.name}", f"scheme {scheme.name}"
    parts = f"{law_name}, {scheme_name}, {type(surface).__name__}"
    sampling = scheme.sampling(kernel, scene.dtype)
    # The scheme's last: an error in a law of the user's is found before all else is compiled.
    sampling, forces, program = program_addresses(
        (sampling, STEP, parts),
        (scheme.forces(kernel, scene.dtype), FORCES, f"{law_name}, {scheme_name}"),
        (scheme.program(kernel, scene.dtype), STEP, scheme_name if sampling else parts),
    )
    if memory is None:
        check_rules(law, kernel, elements, scene, model)
    return PreparedSand(
        **vars(replace(chosen, surface=surface)),
        scheme=scheme,
        packed=packed,
        scene=scene,
        kernel=kernel,
        program=program,
        sampling=sampling,
        forces=forces,
        footprint=footprint,
        update=update_program(surface, scene.dtype["surface"]),
        disabled=(*surface.geoms(model), *chosen.replaced),
    )


def fitted(model: mujoco.MjModel, spec: SandSpec) -> SandSpec:
    """Return a sand whose memory, if it has one, reaches as far as a model needs.

    `Sand` does this itself. Inside `mj_step` the size of the state is fixed before there is a
    model: if you have one, perhaps without the sand, pass the result of this to `add_sand`.
    """
    memory = as_memory(spec.memory)
    if memory is None:
        return spec
    return combined(spec, {"memory": fitting(model, geoms_in_sand(model, spec), memory)})


# What must not change after a sand was made.

_SHAPES = ("geom_type", "geom_size", "geom_pos", "geom_quat")
_GEOMS = (*_SHAPES, "geom_bodyid", "geom_dataid")
_BODIES = ("body_pos", "body_quat", "body_parentid", "body_jntnum", "body_dofadr", "body_dofnum")
_JOINTS = ("jnt_type", "jnt_pos", "jnt_axis", "jnt_bodyid")
_FIELDS = ("hfield_size", "hfield_nrow", "hfield_ncol")
_MESHES = ("mesh_vert", "mesh_face", "mesh_vertadr", "mesh_faceadr")


class Original:
    """Record of the parts of a model that a sand was made from.

    Masses, options, actuators and the heights of a height field are not recorded: they are read at
    each step. The position of the root of a tree is not recorded either: the elements do not depend
    on it. `geoms` meet the sand, `places` are the sand.
    """

    def __init__(self, model: mujoco.MjModel, geoms: Sequence[int], places: Sequence[int]) -> None:
        self._met = list(geoms)
        self.geoms = every = sorted({*geoms, *places})
        bodies = {int(model.geom_bodyid[geom]) for geom in geoms}
        inner = {body for body in bodies if model.body_parentid[body] != 0}
        inner |= {int(model.geom_bodyid[geom]) for geom in places}
        kinds = model.geom_type[every]
        meshes = _MESHES if mujoco.mjtGeom.mjGEOM_MESH in kinds else ()
        fields = _FIELDS if mujoco.mjtGeom.mjGEOM_HFIELD in kinds else ()
        self._rows = {
            **dict.fromkeys(_GEOMS, np.array(every, int)),
            **dict.fromkeys(_BODIES, np.array(sorted(inner), int)),
            **dict.fromkeys((*_JOINTS, *meshes, *fields), slice(None)),
        }
        self._then = {name: getattr(model, name)[rows].copy() for name, rows in self._rows.items()}

    def check_shapes(self, model: mujoco.MjModel) -> None:
        """Check the geoms alone, which takes microseconds."""
        self._check(model, _SHAPES)

    def check(self, model: mujoco.MjModel, geoms: Sequence[int]) -> None:
        """Check everything; `geoms` are the ids that the sand's selection matches now."""
        self._check(model, self._rows)
        if list(geoms) != self._met:
            raise _changed("the selection of geoms that meet the sand")

    def _check(self, model: mujoco.MjModel, names: Iterable[str]) -> None:
        for name in names:
            if not np.array_equal(self._then[name], getattr(model, name)[self._rows[name]]):
                raise _changed(f"{name} of the model")


def _changed(what: str) -> InputError:
    return InputError(
        f"{what} was changed after Sand was made, whose elements are those of before: make another"
    )
