"""Arrows, dots and sand with tracks that the plugin adds to scenes of MuJoCo's visualizer."""

import math

import mujoco
import numpy as np

from mjgranular.engine.block import header_at
from mjgranular.engine.config import DRAWINGS
from mjgranular.engine.tuning import ACTIVE
from mjgranular.kernel import memory
from mjgranular.kernel.compiled import compiled
from mjgranular.kernel.engine import connect_geom, init_geom, record_of
from mjgranular.kernel.intrinsics import call_step
from mjgranular.kernel.memory import field, floats, ints, longs, records, row_of, table_at
from mjgranular.kernel.records import bodies_of, contacts_of
from mjgranular.kernel.vector import cross, dot, norm, read_vector, vector, write_vector
from mjgranular.render.track_kernel import FRAME_DTYPE, canvases
from mjgranular.surface.surface import PLANE_DTYPE

GEOM_DTYPE = record_of("mjvGeom")
_SIZE = GEOM_DTYPE.itemsize

_ARROW, _SPHERE = int(mujoco.mjtGeom.mjGEOM_ARROW), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_PLANE, _SKIN = int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_SKIN)
_FIELD, _OF_SKIN = int(mujoco.mjtGeom.mjGEOM_HFIELD), int(mujoco.mjtObj.mjOBJ_SKIN)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_FORCES, _DEPTH, _SURFACE = (1 << bit for bit in range(len(DRAWINGS)))

_geoms = records(GEOM_DTYPE)
_bytes = records(np.dtype(np.uint8))
_planes = records(PLANE_DTYPE)
_frames = records(FRAME_DTYPE)
_visuals, _statistics = records(record_of("mjVisual")), records(record_of("mjStatistic"))
_vis, _stat = field("mjModel", "vis"), field("mjModel", "stat")
_most, _count = field("mjvScene", "maxgeom"), field("mjvScene", "ngeom")
_geoms_of = field("mjvScene", "geoms")


@compiled
def add_geom(scene, kind):
    """Add a geom to a scene; return its address, 0 if the scene is full."""
    counts = ints(_count(scene), 1)
    if counts[0] >= ints(_most(scene), 1)[0]:
        return 0
    address = _geoms_of(scene) + counts[0] * _SIZE
    raw = _bytes(address, _SIZE)
    for i in range(len(raw)):
        raw[i] = 0
    init_geom(address, kind, 0, 0, 0, 0)
    geom = _geoms(address, 1)[0]
    geom.objid, geom.segid = -1, counts[0]
    geom.category = _DECOR
    counts[0] += 1
    return address


@compiled
def add_arrow(scene, header, bodies, contacts, slots, slot, scale, width):
    """Add an arrow for the force on a body, from the mean of its points of action.

    Its length is `scale` [m/N] times the force.
    """
    weight, total = 0.0, vector(0.0, 0.0, 0.0)
    for i in range(len(contacts)):
        if slots[i] == slot and contacts[i].depth > 0.0:
            size = norm(read_vector(contacts[i].force, 0))
            weight += size
            total += size * read_vector(contacts[i].point, 0)
    arrow = scale * read_vector(bodies[slot].wrench, 0)
    if weight == 0.0 or dot(arrow, arrow) == 0.0:
        return
    address = add_geom(scene, _ARROW)
    if address != 0:
        ends, begin = floats(header.ends, 6), total / weight
        write_vector(ends, 0, begin)
        write_vector(ends, 3, begin + arrow)
        connect_geom(address, _ARROW, width, header.ends, header.ends + 24)
        rgba = _geoms(address, 1)[0].rgba
        rgba[0], rgba[1], rgba[2], rgba[3] = 0.85, 0.35, 0.1, 1.0


@compiled
def add_dot(scene, contact, width, share):
    """Add a dot at an element, yellow at the surface, blue at the greatest depth."""
    address = add_geom(scene, _SPHERE)
    if address != 0:
        geom = _geoms(address, 1)[0]
        geom.size[:] = width
        write_vector(geom.pos, 0, read_vector(contact.point, 0))
        rgba = geom.rgba
        rgba[0], rgba[1], rgba[2], rgba[3] = 1.0 - share, 0.85 * (1.0 - share), share, 1.0


@compiled
def look_like_sand(geom, header):
    """Give a geom the material of sand."""
    geom.matid, geom.texid, geom.texuniform = header.material, header.picture, 1
    geom.texrepeat[0] = geom.texrepeat[1] = 2.0 / header.unit
    geom.specular, geom.shininess, geom.reflectance = 0.0, 0.0, 0.0
    rgba = geom.rgba
    rgba[0], rgba[1], rgba[2], rgba[3] = header.rgb[0], header.rgb[1], header.rgb[2], 1.0


@compiled
def add_sand(scene, header, kind, center, along, across, normal):
    """Add a geom of sand with the given axes in the world; return its address, 0 if none fits."""
    address = add_geom(scene, kind)
    if address != 0:
        geom = _geoms(address, 1)[0]
        look_like_sand(geom, header)
        write_vector(geom.pos, 0, center)
        axes = geom.mat
        axes[0], axes[1], axes[2] = along.x, across.x, normal.x
        axes[3], axes[4], axes[5] = along.y, across.y, normal.y
        axes[6], axes[7], axes[8] = along.z, across.z, normal.z
    return address


@compiled
def add_surface(scene, header, surface, middle):
    """Add the plane of sand at its height, around a point."""
    plane = _planes(surface, 1)[0]
    normal = read_vector(plane.normal, 0)
    length = math.sqrt(normal.x * normal.x + normal.z * normal.z)
    along = vector(normal.z / length, 0.0, -normal.x / length)
    across = cross(normal, along)
    x0, y0 = dot(along, middle), dot(across, middle)
    if not math.isfinite(x0 + y0):
        return
    x0 = math.floor(x0 / header.unit + 0.5) * header.unit
    y0 = math.floor(y0 / header.unit + 0.5) * header.unit
    for i in range(header.tile_count):
        tile = row_of(header.tiles, i, 4)
        x, y = x0 + tile[0] * header.unit, y0 + tile[1] * header.unit
        center = x * along + y * across + (plane.offset - header.lowered) * normal
        address = add_sand(scene, header, _PLANE, center, along, across, normal)
        if address == 0:
            return
        size = _geoms(address, 1)[0].size
        size[0], size[1] = tile[2] * header.unit, tile[3] * header.unit


@compiled
def lay_prints(header, surface, middle, model):
    """Fit the skin to sand with tracks, around a point, before MuJoCo computes its normals."""
    canvas = canvases(header.canvas, 1)[0]
    canvas.surface = surface
    if canvas.held == 0:
        frame = _frames(surface + header.frame, 1)[0]
        away = middle - read_vector(frame.origin, 0)
        canvas.middle[0] = dot(read_vector(frame.along, 0), away)
        canvas.middle[1] = dot(read_vector(frame.across, 0), away)
    canvas.vertices = longs(model + header.skin_pointer, 1)[0] + header.skin_offset
    call_step(header.shape_program, header.canvas, 0.0)


@compiled
def add_prints(scene, header):
    """Add sand with tracks: skin, rectangles, or a field beyond it."""
    canvas = canvases(header.canvas, 1)[0]
    frame = _frames(canvas.surface + header.frame, 1)[0]
    origin, along = read_vector(frame.origin, 0), read_vector(frame.along, 0)
    across, normal = read_vector(frame.across, 0), read_vector(frame.normal, 0)
    address = add_geom(scene, _SKIN)
    if address == 0:
        return
    geom = _geoms(address, 1)[0]
    look_like_sand(geom, header)
    geom.objtype, geom.objid, geom.texcoord = _OF_SKIN, header.skin, 1
    geom.texrepeat[0] = geom.texrepeat[1] = 1.0 / header.unit
    if header.ground >= 0 and canvas.held == 0:
        center = origin + canvas.sunk * normal
        address = add_sand(scene, header, _FIELD, center, along, across, normal)
        if address != 0:
            _geoms(address, 1)[0].dataid = header.ground_data
    rectangles = floats(canvas.rectangles, 4 * canvas.room)
    for i in range(canvas.count):
        center = origin + rectangles[4 * i] * along + rectangles[4 * i + 1] * across
        address = add_sand(scene, header, _PLANE, center, along, across, normal)
        if address == 0:
            return
        size = _geoms(address, 1)[0].size
        size[0], size[1] = rectangles[4 * i + 2], rectangles[4 * i + 3]


@compiled
def draw(block, scene, model, prints):
    """Add what a block draws: sand, an arrow for each body, a dot for each element in it.

    Block, scene and model are addresses; `prints` is true if the sand is drawn with tracks.
    """
    header = header_at(block)
    if header.draw == 0:
        return
    table = table_at(header.table)
    bodies, contacts = bodies_of(table), contacts_of(table)
    slots = longs(header.slots, len(contacts))
    if header.draw & _SURFACE and (header.tuned == 0 or header.applied[ACTIVE] != 0.0):
        surface = table[memory.SCENE] + header.plane
        middle = read_vector(row_of(table[memory.XIPOS], bodies[0].body, 3), 0)
        if prints:
            lay_prints(header, surface, middle, model)
            add_prints(scene, header)
        elif header.tile_count != 0:
            add_surface(scene, header, surface, middle)
    visual, statistic = _visuals(_vis(model), 1)[0], _statistics(_stat(model), 1)[0]
    width = visual.scale.forcewidth * statistic.meansize
    if header.draw & _FORCES:
        length = visual.map.force / statistic.meanmass
        for slot in range(len(bodies)):
            add_arrow(scene, header, bodies, contacts, slots, slot, length, width)
    if header.draw & _DEPTH:
        deepest = 0.0
        for i in range(len(contacts)):
            deepest = max(deepest, contacts[i].depth)
        for i in range(len(contacts)):
            if contacts[i].depth > 0.0:
                add_dot(scene, contacts[i], width, contacts[i].depth / deepest)
