"""A model with sand in a web browser: robots by mjviser, sand as the plugin draws it."""

import copy
import ctypes
import socket
import time
import warnings
from contextlib import nullcontext
from functools import partial
from typing import Any

import mujoco
import numpy as np
import rich

from mjgranular._util.checks import require
from mjgranular.errors import InputError
from mjgranular.kernel.engine import offset_of, record_of
from mjgranular.picture.viewer import Command, Switch
from mjgranular.render.material import COLOR, MATERIAL, NOT_SHOWN, radius_of, texture_of

_WAIT, _SHARE = 0.1, 0.1  # of meshes of sand: time between two [s], share of all time; chosen
_SUN = {"position": (7.0, -2.6, 4.0), "intensity": 1.5, "cast_shadow": True}  # low, to show relief
_GAMMA = 2.2  # of MuJoCo's colors; those of meshes in browsers are linear
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION.value
_GEOM = record_of("mjvGeom")
_DECOR = mujoco.mjtCatBit.mjCAT_DECOR.value  # what is not in the model: sand, arrows, dots
_KINDS = "PLANE", "HFIELD", "BOX", "SKIN", "ARROW", "SPHERE"
_PLANE, _FIELD, _BOX, _SKIN, _ARROW, _SPHERE = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in _KINDS
)
_import = partial(require, extra="web", purpose="A view in the browser")


def check_address(host: str, port: int) -> None:
    """Check that a page can be served."""
    _import("mjviser")
    if not 1 <= port <= 65535:
        raise InputError(f"the port must be from 1 to 65535, got {port}")
    try:
        socket.create_server((host, port)).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"no page can be served at {host}, port {port}: {reason}") from None


class Page:
    """A page with a model, which `viewer.follow` takes for a window."""

    lock = nullcontext  # `sync` reads the controls, in the thread that simulates

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, switch: Switch, host: str, port: int
    ) -> None:
        self._model, self._data, self._switch = model, data, switch
        self._scene = scene = mujoco.MjvScene(model, maxgeom=10_000)  # as in MuJoCo's viewer
        seen = _DECOR | mujoco.mjtCatBit.mjCAT_STATIC.value  # and a floor with the look of sand
        self._view = mujoco.MjvOption(), None, mujoco.MjvCamera(), seen
        # All geoms in memory: MuJoCo's attributes of one take 0.1 ms each.
        begin = scene.geoms[0].pos.ctypes.data - offset_of("mjvGeom", "pos")
        memory = (ctypes.c_char * (scene.maxgeom * _GEOM.itemsize)).from_address(begin)
        self._geoms = np.frombuffer(memory, _GEOM)
        self._start = np.zeros(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._due, self._last = 0.0, (0.0, 0.0)  # of meshes of sand: next time, last times
        self._drawn, self._meshes, self._old, self._parity = None, [], [], 0
        shown = copy.copy(model)  # mjviser changes it, shows every plane, and boxes without texture
        names = [model.material(k).name for k in range(model.nmat)]
        self._sand = sand = [k for k, name in enumerate(names) if name.endswith(MATERIAL)]
        hidden = (shown.geom_group == NOT_SHOWN) | np.isin(shown.geom_matid, sand)
        hidden &= shown.geom_type == _PLANE
        shown.geom_type[hidden], shown.geom_rgba[hidden, 3] = _BOX, 0.0
        beds = np.isin(shown.geom_matid, sand) & (shown.geom_type == _BOX)
        shown.geom_matid[beds], shown.geom_rgba[beds] = -1, np.power(COLOR, _GAMMA)
        rich.get_console().quiet = True  # viser prints to it
        self._server = server = _import("viser").ViserServer(host=host, port=port, verbose=False)
        with warnings.catch_warnings(action="ignore"):  # of sand: the user has seen them
            self._robot = _import("mjviser").ViserMujocoScene(server, shown, num_envs=1)
        self._world = world = self._robot.fixed_bodies_frame.name  # moves for the camera to follow
        server.scene.configure_environment_map(environment_intensity=0.25)
        server.scene.configure_default_lights(False)
        server.scene.add_light_directional("/sun", **_SUN)
        width = model.vis.scale.forcewidth * model.stat.meansize
        self._arrows = server.scene.add_arrows(
            f"{world}/forces", np.zeros((1, 2, 3)), (217, 89, 26), shaft_radius=width / 2,
            head_radius=width, head_length=2 * width,
        )  # fmt: skip
        self._dots = server.scene.add_point_cloud(
            f"{world}/depth", np.zeros((1, 3)), (0, 0, 0), point_size=width, precision="float32"
        )
        self._time = server.gui.add_text("Time", "", disabled=True)
        self._pause = server.gui.add_checkbox("Pause", switch.held)
        self._speed = server.gui.add_number("Speed", switch.speed, min=1e-3, step=1e-3)
        self._restart = server.gui.add_button("Restart")
        limits = switch.command.limits if switch.command else ()
        self._command = [
            server.gui.add_slider(part, low, high, 0.05, min(max(0.0, low), high))
            for part, (low, high) in zip(Command.PARTS, limits, strict=False)
        ]
        self._robot.create_scene_gui(camera_distance=3 * radius_of(model))

    @property
    def address(self) -> str:
        """Address of the page, with another port if the requested one is taken by now."""
        host = self._server.get_host()
        names = {"127.0.0.1": "localhost", "0.0.0.0": socket.gethostname()}
        return f"http://{names.get(host, host)}:{self._server.get_port()}"

    def close(self) -> None:
        self._server.stop()

    def is_running(self) -> bool:
        """Return True: the page is there until the command ends."""
        return True

    def sync(self) -> None:
        """Read the controls, and send what has changed."""
        model, data, now = self._model, self._data, time.perf_counter()
        self._switch.held, self._switch.speed = self._pause.value, max(self._speed.value, 1e-3)
        if self._switch.command is not None:
            self._switch.command.values[:] = [slider.value for slider in self._command]
        if self._restart.value:
            self._restart.value = False
            mujoco.mj_setState(model, data, self._start, _STATE)
            mujoco.mj_forward(model, data)
        self._robot.update_from_mjdata(data)
        mujoco.mjv_updateScene(model, data, *self._view, self._scene)
        geoms = self._geoms[: self._scene.ngeom]
        ours = geoms["category"] == _DECOR
        floors = geoms[~ours & (geoms["type"] == _PLANE) & np.isin(geoms["matid"], self._sand)]
        geoms = geoms[ours]
        arrows, dots = (geoms[geoms["type"] == kind] for kind in (_ARROW, _SPHERE))
        self._arrows.visible, self._dots.visible = bool(len(arrows)), bool(len(dots))
        if len(arrows):
            ends = arrows["size"][:, 2:] * arrows["mat"].reshape(-1, 3, 3)[:, :, 2]
            self._arrows.points = arrows["pos"][:, None] + np.stack([0 * ends, ends], axis=1)
        if len(dots):
            self._dots.points = dots["pos"].copy()
            self._dots.colors = (255 * dots["rgba"][:, :3]).astype(np.uint8)
        if now >= self._due:
            drawn = geoms[np.isin(geoms["type"], (_PLANE, _FIELD, _SKIN))]
            self._draw_sand(np.concatenate([floors, drawn]))
            rate = max(data.time - self._last[1], 0.0) / (now - self._last[0])
            self._time.value = f"{data.time:.2f} s, {rate:.2f} x real time"
            self._last = now, data.time
            self._due = now + max(_WAIT, (time.perf_counter() - now) / _SHARE)

    def _draw_sand(self, geoms: np.ndarray) -> None:
        """Draw sand that has changed; browsers show the old until they have read the new."""
        for mesh in self._old:
            mesh.remove()
        drawn = [geoms[name].tobytes() for name in ("pos", "mat", "size", "matid", "rgba")]
        self._old, drawn = [], [*drawn, self._scene.skinvert.tobytes()]
        if drawn == self._drawn:
            return
        self._drawn, self._old, self._meshes = drawn, self._meshes, []
        self._parity = 1 - self._parity  # new meshes have other names than old ones
        colors = geoms[["matid", "rgba"]]
        for color in np.unique(colors):
            material = self._material(color)
            parts = [self._surface(geom, material) for geom in geoms[colors == color]]
            mesh = _import("trimesh").util.concatenate(parts)
            name = f"{self._world}/sand {len(self._meshes)} {self._parity}"
            self._meshes.append(self._server.scene.add_mesh_trimesh(name, mesh, cast_shadow=False))

    def _surface(self, geom: np.void, material: Any) -> Any:
        model, trimesh = self._model, _import("trimesh")
        if geom["type"] == _SKIN:
            k = int(geom["objid"])
            points = self._scene.skinvert.reshape(-1, 3)[model.skin_vertadr[k] :]
            faces = model.skin_face[model.skin_faceadr[k] :][: model.skin_facenum[k]]
            a, b, c = points[faces].transpose(1, 0, 2)
            faces = faces[np.cross(b - a, c - a).any(axis=1)]  # others are hidden
            used, faces = np.unique(faces, return_inverse=True)
            points, faces = points[used], faces.reshape(-1, 3)
            uv = model.skin_texcoord[model.skin_texcoordadr[k] + used] * geom["texrepeat"]
        else:
            rows, columns, heights, size = 2, 2, np.zeros(4), geom["size"]
            if geom["type"] == _FIELD:
                k = int(geom["dataid"])
                rows, columns = model.hfield_nrow[k], model.hfield_ncol[k]
                size = model.hfield_size[k]
                heights = model.hfield_data[model.hfield_adr[k] :][: rows * columns]
            y, x = np.indices((rows, columns)).reshape(2, -1) / [[rows - 1], [columns - 1]] * 2 - 1
            points = np.column_stack([x, y, heights]) * size[:3]
            a = np.arange(rows * columns).reshape(rows, columns)[:-1, :-1].ravel()
            faces = np.column_stack([a, a + 1, a + columns + 1, a + columns])
            points = geom["pos"] + points @ geom["mat"].reshape(3, 3).T
            uv = points[:, :2] * geom["texrepeat"] / 2  # MuJoCo repeats it over half the edges
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        return trimesh.Trimesh(points, faces, visual=visual, process=False)

    def _material(self, color: np.void) -> Any:
        model, image = self._model, None
        if (k := texture_of(model, int(color["matid"]))) >= 0:
            size = model.tex_height[k], model.tex_width[k], model.tex_nchannel[k]
            pixels = model.tex_data[model.tex_adr[k] :][: np.prod(size, dtype=int)]
            image = _import("PIL.Image").fromarray(pixels.reshape(size))
        new, factor = _import("trimesh").visual.material.PBRMaterial, color["rgba"] ** _GAMMA
        return new(
            baseColorTexture=image, baseColorFactor=factor, metallicFactor=0, roughnessFactor=1
        )
