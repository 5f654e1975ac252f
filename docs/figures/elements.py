"""What `draw_elements` and `add_elements` show: rods, facets, and facets in a rendered scene."""

from __future__ import annotations

# Before mujoco: it chooses how to draw without a screen.
import mjgranular  # isort: skip  # noqa: F401
import mujoco
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from style import save

from mjgranular import Sand
from mjgranular.models import model_path
from mjgranular.picture.elements import add_elements, draw_elements

_WIDTH, _HEIGHT = 640, 560  # of one panel [pixels]

FOOT = """
<mujoco><visual><headlight ambient="0.5 0.5 0.5" diffuse="0.5 0.5 0.5" specular="0 0 0"/></visual>
<asset><texture type="skybox" builtin="gradient" rgb1="0.95 0.96 0.97" rgb2="0.76 0.82 0.88"
  width="128" height="128"/></asset>
<worldbody><light pos="-0.3 -0.5 1" dir="0.3 0.5 -1" diffuse="0.4 0.4 0.4" castshadow="false"/>
  <body name="foot" pos="0 0 0.005"><freejoint/>
    <geom name="sole" type="box" size="0.08 0.05 0.015"/>
    <body name="shin"><joint axis="0 1 0" pos="0 0 0.02"/>
      <geom name="shin" type="capsule" size="0.02" fromto="0 0 0.035 0.05 0 0.17"/></body></body>
</worldbody></mujoco>"""


def drawn(sand: Sand, data: mujoco.MjData | None = None) -> np.ndarray:
    """The figure of the elements as pixels."""
    figure = draw_elements(sand, data)
    figure.set_dpi(100)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def rendered() -> np.ndarray:
    """A scene with the elements and the sand's force on each."""
    spec = mujoco.MjSpec.from_string(FOOT)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = _WIDTH, _HEIGHT
    model = spec.compile()
    sand = Sand(model, medium="quikrete_medium")
    data = mujoco.MjData(model)
    data.qvel[[0, 2]] = 0.3, -0.2
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.0, 0.0, 0.055
    camera.distance, camera.azimuth, camera.elevation = 0.43, 118.0, -16.0
    with mujoco.Renderer(model, _HEIGHT, _WIDTH) as renderer:
        renderer.update_scene(data, camera)
        add_elements(renderer.scene, sand, data, forces=True)
        return renderer.render()


def main() -> None:
    """Draws the figure."""
    pendulum = mujoco.MjModel.from_xml_path(str(model_path("double_pendulum")))
    start = mujoco.MjData(pendulum)
    mujoco.mj_resetDataKeyframe(pendulum, start, pendulum.key("start").id)
    foot = mujoco.MjModel.from_xml_string(FOOT)
    panels = [
        drawn(Sand(pendulum, law="link_distributed"), start),
        drawn(Sand(foot, medium="quikrete_medium")),
        rendered(),
    ]
    figure = plt.figure(figsize=(9.6, 2.8), dpi=160, layout="none")
    for k, panel in enumerate(panels):
        axes = figure.add_axes((k / 3, 0, 1 / 3, 1))
        axes.imshow(panel)
        axes.set_axis_off()
    save(figure, "elements")


if __name__ == "__main__":
    main()
