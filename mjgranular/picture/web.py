"""A model with sand in a web browser: robots by mjviser, sand as the plugin draws it."""

from __future__ import annotations

import copy
import ctypes
import socket
import time
from contextlib import nullcontext
from functools import partial
from typing import Any

import mujoco
import numpy as np
import rich

from mjgranular._util.extras import require
from mjgranular.errors import InputError
from mjgranular.kernel.structs import record_of
from mjgranular.picture.viewer import Switch
from mjgranular.render.material import COLOR, MATERIAL, NOT_SHOWN, radius_of, texture_of

_WAIT, _SHARE = 0.1, 0.1  # of meshes of sand: time between two [s], share of all time; chosen
_SUN = {"position": (7.0, -2.6, 6.6), "intensity": 3.0, "cast_shadow": True}  # low, to show relief
_GAMMA = 2.2  # of screens: browsers take colors without it
_WORLD = "/fixed_bodies"  # mjviser moves it so that the camera follows the robot
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION.value
_GEOM = record_of("mjvGeom")
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
        self._scene = mujoco.MjvScene(model, maxgeom=10_000)  # as in MuJoCo's viewer
        self._start = np.zeros(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, data, self._start, _STATE)
        self._due, self._last = 0.0, (0.0, 0.0)
        self._drawn, self._meshes, self._old, self._turn = None, [], [], 0
        shown = copy.copy(model)  # mjviser changes it, shows every plane, and boxes without texture
        hidden = (shown.geom_type == _PLANE) & (shown.geom_group == NOT_SHOWN)
        shown.geom_type[hidden], shown.geom_rgba[hidden, 3] = _BOX, 0.0
        sand = [k for k in range(model.nmat) if model.material(k).name.endswith(MATERIAL)]
        beds = np.isin(shown.geom_matid, sand) & (shown.geom_type == _BOX)
        shown.geom_matid[beds], shown.geom_rgba[beds] = -1, np.power(COLOR, _GAMMA)
        rich.get_console().quiet = True  # viser prints to it
        self._server = server = _import("viser").ViserServer(host=host, port=port, verbose=False)
        self._robot = _import("mjviser").ViserMujocoScene(server, shown, num_envs=1)
        server.scene.configure_environment_map(environment_intensity=0.4)
        server.scene.configure_default_lights(False)
        server.scene.add_light_directional("/sun", **_SUN)
        width = model.vis.scale.forcewidth * model.stat.meansize
        self._arrows = server.scene.add_arrows(
            f"{_WORLD}/forces", np.zeros((1, 2, 3)), (217, 89, 26), shaft_radius=width / 2,
            head_radius=width, head_length=2 * width,
        )  # fmt: skip
        self._dots = server.scene.add_point_cloud(
            f"{_WORLD}/depth", np.zeros((1, 3)), (0, 0, 0), point_size=width, precision="float32"
        )
        self._time = server.gui.add_text("Time", "", disabled=True)
        self._pause = server.gui.add_checkbox("Pause", switch.held)
        self._speed = server.gui.add_number("Speed", switch.speed, min=1e-3, step=1e-3)
        self._restart = server.gui.add_button("Restart")
        self._robot.create_scene_gui(camera_distance=4 * radius_of(model))

    def close(self) -> None:
        """End the page."""
        self._server.stop()

    def is_running(self) -> bool:
        """Return True: the page is there until the command ends."""
        return True

    def sync(self) -> None:
        """Read the controls, and send what has changed."""
        model, data, now = self._model, self._data, time.perf_counter()
        self._switch.held, self._switch.speed = self._pause.value, max(self._speed.value, 1e-3)
        if self._restart.value:
            self._restart.value = False
            mujoco.mj_setState(model, data, self._start, _STATE)
            mujoco.mj_forward(model, data)
        self._robot.update_from_mjdata(data)
        kinds, option, camera = mujoco.mjtCatBit.mjCAT_DECOR, mujoco.MjvOption(), mujoco.MjvCamera()
        mujoco.mjv_updateScene(model, data, option, None, camera, kinds.value, self._scene)
        geoms = np.zeros(0, _GEOM)
        if self._scene.ngeom:
            begin = self._scene.geoms[0].pos.ctypes.data - _GEOM.fields["pos"][1]
            memory = ctypes.c_char * (self._scene.ngeom * _GEOM.itemsize)
            geoms = np.frombuffer(memory.from_address(begin), _GEOM)
        arrows, dots = (geoms[geoms["type"] == kind] for kind in (_ARROW, _SPHERE))
        self._arrows.visible, self._dots.visible = bool(len(arrows)), bool(len(dots))
        if len(arrows):
            ends = arrows["size"][:, 2:] * arrows["mat"].reshape(-1, 3, 3)[:, :, 2]
            self._arrows.points = arrows["pos"][:, None] + np.stack([0 * ends, ends], axis=1)
        if len(dots):
            self._dots.points = dots["pos"].copy()
            self._dots.colors = (255 * dots["rgba"][:, :3]).astype(np.uint8)
        if now >= self._due:
            self._draw_sand(geoms[np.isin(geoms["type"], (_PLANE, _FIELD, _SKIN))])
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
        self._drawn, self._old, self._meshes, self._turn = drawn, self._meshes, [], 1 - self._turn
        looks = geoms[["matid", "rgba"]]
        for look in np.unique(looks):
            material = self._material(look)
            parts = [self._surface(geom, material) for geom in geoms[looks == look]]
            mesh = _import("trimesh").util.concatenate(parts)
            name = f"{_WORLD}/sand {len(self._meshes)} {self._turn}"
            self._meshes.append(self._server.scene.add_mesh_trimesh(name, mesh, cast_shadow=False))

    def _surface(self, geom: np.void, material: Any) -> Any:
        """Return the surface that a geom draws."""
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
            points = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * geom["size"]
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            if geom["type"] == _FIELD:
                of_it = (model.geom_type == _FIELD) & (model.geom_dataid == geom["dataid"])
                field = _import("mjviser.conversions").create_primitive_mesh(model, of_it.argmax())
                points, faces = field.vertices, field.faces
            points = geom["pos"] + points @ geom["mat"].reshape(3, 3).T
            uv = points[:, :2] * geom["texrepeat"] / 2  # MuJoCo repeats it over half the edges
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        return trimesh.Trimesh(points, faces, visual=visual, process=False)

    def _material(self, look: np.void) -> Any:
        """Return a material of the model."""
        model, image = self._model, None
        if (k := texture_of(model, int(look["matid"]))) >= 0:
            size = model.tex_height[k], model.tex_width[k], model.tex_nchannel[k]
            pixels = model.tex_data[model.tex_adr[k] :][: np.prod(size, dtype=int)]
            image = _import("PIL.Image").fromarray(pixels.reshape(size))
        made, color = _import("trimesh").visual.material.PBRMaterial, look["rgba"] ** _GAMMA
        return made(
            baseColorTexture=image, baseColorFactor=color, metallicFactor=0.0, roughnessFactor=1.0
        )
