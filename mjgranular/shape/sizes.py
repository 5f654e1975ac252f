"""Names and sizes of geoms, limits on sizes and on numbers of elements, the default resolution."""

from collections.abc import Sequence

import mujoco
import numpy as np

from mjgranular.errors import InputError

SMALLEST, LARGEST = 1e-9, 1e9
"""Limits of half extents of geoms [m]; chosen: far within numbers that can be squared twice."""

MOST_ELEMENTS = 1_000_000
"""Maximum number in one sand; chosen: a step then takes tens of milliseconds, tables 1 GB."""

PART_FIELDS = (
    ("geom", np.int64),
    ("body", np.int64),
    ("slot", np.int64),  # row of the body in the binding's table of bodies
)
"""Fields with which the records of all kinds of elements begin."""

_GEOM = mujoco.mjtGeom


def name_of(model: mujoco.MjModel, kind: str, number: int) -> str:
    """Return the name of a body, geom or the like, "" for none; escape bytes that are not UTF-8.

    MuJoCo accepts such bytes, but its Python bindings raise `UnicodeDecodeError` on reading them.
    """
    names, begin = model.names, int(getattr(model, f"name_{kind}adr")[number])
    return names[begin : names.index(b"\0", begin)].decode(errors="backslashreplace")


def geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return a geom's name in quotes, or its id."""
    name = name_of(model, "geom", geom)
    return repr(name) if name else f"number {geom}"


def geom_type(model: mujoco.MjModel, geom: int) -> str:
    """Return the type of a geom in a word."""
    return _GEOM(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()


def set_bodies(model: mujoco.MjModel, elements: np.ndarray) -> None:
    """Set `body` and `slot` of elements, of which `geom` is set (`PART_FIELDS`)."""
    bodies = model.geom_bodyid[elements["geom"]].tolist()
    slots = {body: row for row, body in enumerate(dict.fromkeys(bodies))}
    elements["body"], elements["slot"] = bodies, [slots[body] for body in bodies]


def data_at_start(model: mujoco.MjModel) -> mujoco.MjData:
    """Return a simulation with the poses at `qpos0`."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def geom_axes(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return the axes of a geom in the frame of its body, in columns, shape (3, 3)."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return rotation.reshape(3, 3)


def geom_width(model: mujoco.MjModel, geom: int) -> float:
    """Return the width of a geom: its second largest extent [m], such as a rod's diameter."""
    return float(np.sort(2 * half_extents(model, geom))[1])


def half_extents(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Return half extents of a geom along its own axes [m], shape (3,)."""
    size = model.geom_size[geom]
    kind = int(model.geom_type[geom])
    if kind == _GEOM.mjGEOM_SPHERE:
        return np.full(3, size[0])
    if kind in (_GEOM.mjGEOM_CAPSULE, _GEOM.mjGEOM_CYLINDER):
        cap = size[0] if kind == _GEOM.mjGEOM_CAPSULE else 0.0
        return np.array([size[0], size[0], size[1] + cap])
    if kind == _GEOM.mjGEOM_MESH:
        return model.geom_aabb[geom, 3:]
    return size


def rod_length(points: np.ndarray, areas: np.ndarray, offsets: np.ndarray, parts: float) -> float:
    """Return the length of the rod that has the greatest radius of gyration of a surface [m].

    Of its pieces `points` are the centers, and the sum of squares of the `offsets` from them, shape
    (n, k, dimensions), over `parts` is the second moment.
    """
    area = areas.sum()
    away = points - areas @ points / area
    moments = np.einsum("n,ni,nj->ij", areas, away, away)
    moments += np.einsum("n,nki,nkj->ij", areas, offsets, offsets) / parts
    return float(np.sqrt(12 * max(np.linalg.eigvalsh(moments / area)[-1], 0.0)))


def check_size(model: mujoco.MjModel, geom: int, *, flat: bool = False) -> None:
    """Check that a geom has a volume within numerical limits, or is `flat`, as a mesh may be."""
    half = half_extents(model, geom)
    if flat:
        half = half[half.argmax() :][:1]
    if not (half > 0).all():
        raise InputError(f"geom {geom_name(model, geom)} has a size of zero: it needs a volume")
    check_extents(f"geom {geom_name(model, geom)}", half)


def type_error(model: mujoco.MjModel, geom: int) -> InputError:
    """Return the error for a geom of a type that sand does not act on."""
    return InputError(
        f"geom {geom_name(model, geom)} is a {geom_type(model, geom)}: sand acts on capsules, "
        "spheres, cylinders, ellipsoids, boxes and meshes"
    )


def check_extents(what: str, half: Sequence[float] | np.ndarray) -> None:
    """Check that half extents [m] of `what` are within numerical limits."""
    for value in half:
        if not SMALLEST <= value <= LARGEST:
            raise InputError(
                f"{what} has a half extent of {value:g} m: it must be from {SMALLEST:g} to "
                f"{LARGEST:g} m"
            )


def check_count(count: int) -> None:
    """Check that there are not too many elements."""
    if count > MOST_ELEMENTS:
        raise InputError(
            f"the geoms would have {count:,} elements, more than {MOST_ELEMENTS:,}: take a lower "
            "resolution, or fewer geoms"
        )


RESOLUTION = 12
"""Rings from pole to pole of a round geom: the fewest with which the total force on every tested
primitive is within 2 % of that on a fine mesh (tests/physics/test_facets.py, docs/shapes.md)."""

FACETS = 4000
"""Approximate default number of facets of all geoms together. Chosen: Gymnasium's robots have fewer
at `RESOLUTION`, and a humanoid of forty meshes takes about three times as long as without sand."""

_ALIKE = 1.02  # sizes that differ by less count as equal; chosen
_LEAST = 4  # a sphere of 24 facets; coarser ones are not spheres
_OF_A_MESH, _OF_OTHERS = 2.0, 4 / 3  # maximum number of facets, over the square of the resolution


def resolutions(model: mujoco.MjModel, geoms: Sequence[int]) -> list[int]:
    """Return a resolution for each geom, so that there are about `FACETS` facets or fewer.

    Beyond these, geoms share them by their surface area: facets become similar in size, none finer
    than with `RESOLUTION`.
    """
    meshes = model.geom_type[list(geoms)] == int(mujoco.mjtGeom.mjGEOM_MESH)
    weights = np.where(meshes, _OF_A_MESH, _OF_OTHERS)
    if weights.sum() * RESOLUTION**2 <= FACETS:
        return [RESOLUTION] * len(geoms)
    # Invalid sizes are reported later. Valid ones, relative to the largest.
    half = np.nan_to_num([np.abs(half_extents(model, geom)) for geom in geoms])
    half /= max(half.max(), np.finfo(float).tiny)
    size = np.sqrt((half * np.roll(half, 1, axis=1)).sum(axis=1))  # root of the surface of its box

    def cut(facet: float) -> np.ndarray:
        return np.clip(size / facet, _LEAST, RESOLUTION).astype(int)

    fine, coarse = 1e-9, 1.0
    for _ in range(60):
        middle = (fine * coarse) ** 0.5
        if weights @ cut(middle) ** 2 > FACETS:
            fine = middle
        else:
            coarse = middle
    # Left and right of a robot differ slightly: sizes that near to a bound stay together.
    return cut(_ALIKE * coarse).tolist()
