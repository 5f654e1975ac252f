"""Write sand into an `MjSpec`."""

from collections.abc import Sequence
from itertools import chain, count
from typing import Unpack

import mujoco

from mjgranular._util.checks import check_kind, check_switch, kind_of
from mjgranular.engine.config import NAME, write_config
from mjgranular.engine.plugin import check_registered
from mjgranular.errors import InputError
from mjgranular.relief.memory import as_memory
from mjgranular.render import add_skin
from mjgranular.render.material import NOT_SHOWN, add_material, paint
from mjgranular.sand.spec import SandFields, SandSpec, combined
from mjgranular.shape.select import names_in
from mjgranular.surface import Bed, HeightField, surface_of


def add_sand(
    spec: mujoco.MjSpec,
    sand: SandSpec | None = None,
    *,
    draw: Sequence[str] | str = ("surface",),
    tunable: bool = False,
    name: str | None = None,
    **fields: Unpack[SandFields],
) -> mujoco.MjsPlugin:
    """Add sand to a model: from then on it acts inside `mj_step`.

    It adds an instance of the plugin `mjgranular.sand`, which is preserved in XML. Called twice, it
    adds two: two media in two beds, for example. If the surface is drawn, a material and its
    texture are added, a bed or height field without a color gets that material, and geoms that the
    sand replaces are moved to geom group 5, which is hidden. A bed or height field loses its
    contacts, which the sand would switch off in any case.

    Args:
        spec: the model to be.
        sand: the sand, made of named parts; None for the defaults.
        draw: what viewers and renderers show: "surface", "forces", "depth"; () for nothing.
        tunable: let each simulation have its own strength, density and height of the sand, as a
            part of MuJoCo's state (`tune`).
        name: name of the instance; None for "sand", "sand_2", ...
        **fields: fields of `SandSpec`, which documents them; they replace those of `sand`.

    Raises:
        InputError: an object has no name to be written by, or the name is taken. What does not fit
            the model is found when it is compiled.
        LayoutError: this version of MuJoCo cannot be used with the plugin.
    """
    check_kind(spec, mujoco.MjSpec, "add_sand")
    check_switch("tunable", tunable)
    if name is not None and not (isinstance(name, str) and name):
        raise InputError(f"the name of an instance must be a string, not {kind_of(name)}")
    check_registered()
    sand = combined(sand, fields)
    config = write_config(sand, draw=draw, tunable=tunable)
    taken = {plugin.name for plugin in spec.plugins}
    if name is None:
        names = chain(["sand"], (f"sand_{number}" for number in count(2)))
        name = next(free for free in names if free not in taken)
    elif name in taken:
        raise InputError(f"the model has a plugin instance named {name!r} already")
    spec.activate_plugin(NAME)
    instance = spec.add_plugin(name=name, plugin_name=NAME, active=True)
    instance.config = config
    _attach(spec, name)
    if (bed := _bed_of(spec, sand)) is not None:  # so that no other sand warns of its contacts
        bed.contype = bed.conaffinity = 0
    if "surface" in config.get("draw", "").split():
        show_surface(spec, sand)
        show_prints(spec, sand, name)
    return instance


def _bed_of(spec: mujoco.MjSpec, sand: SandSpec) -> mujoco.MjsGeom | None:
    """Return the geom that is the sand, if one is."""
    surface = surface_of(sand.surface)
    return spec.geom(surface.geom) if isinstance(surface, Bed | HeightField) else None


def show_surface(spec: mujoco.MjSpec, sand: SandSpec) -> None:
    """Set the appearance of a model's geoms: those that are sand, and those that it replaces."""
    material = add_material(spec)
    if (bed := _bed_of(spec, sand)) is not None:
        paint(bed, material)
    of_world = spec.worldbody.geoms  # these have the lowest ids
    for name in names_in(sand.instead_of):
        replaced = spec.geom(str(name))
        if replaced is None and str(name).isdecimal() and int(name) < len(of_world):
            replaced = of_world[int(name)]
        if replaced is not None:
            replaced.group = NOT_SHOWN


def show_prints(spec: mujoco.MjSpec, sand: SandSpec, name: str = "sand") -> None:
    """Add the geometry that draws tracks for a sand with memory; nothing without memory."""
    memory = as_memory(sand.memory)
    if memory is None:
        return
    surface, thickness = surface_of(sand.surface), 0.0
    material, rgb = add_material(spec), (1.0, 1.0, 1.0)
    if isinstance(surface, Bed | HeightField):
        bed = spec.geom(surface.geom)
        if bed is None:
            return  # compiling the model reports the error
        material, rgb, thickness = bed.material, tuple(bed.rgba[:3]), 2 * float(bed.size[2])
    add_skin(spec, memory, material, sand=name, rgb=rgb, thickness=thickness)


def _attach(spec: mujoco.MjSpec, name: str) -> None:
    """Have the world and a body refer to the instance.

    It does not affect the physics. But `MjSpec` silently drops instances that nothing refers to:
    `copy` and `delete` keep what the world refers to, and `attach` what an attached body does.
    """
    world, *bodies = spec.bodies
    free = [body for body in bodies if not body.plugin.active]
    chosen = sorted(free, key=lambda body: not body.joints)[:1]  # others may be fused
    if not world.plugin.active or (not chosen and world.plugin.plugin_name == NAME):
        chosen.append(world)
    for body in chosen:
        body.plugin.active = True
        body.plugin.plugin_name = NAME
        body.plugin.name = name
