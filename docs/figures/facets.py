"""The facets that primitives are cut into by default: patches, normals at their centroids."""

from __future__ import annotations

from collections.abc import Callable
from unittest.mock import patch

import mujoco
import numpy as np
from matplotlib import pyplot as plt
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from style import ORANGE, save

from mjgranular.shape import facets_from_model, tessellation

SHAPES = {
    "sphere": "0.05",
    "ellipsoid": "0.06 0.045 0.03",
    "capsule": "0.025 0.035",
    "cylinder": "0.04 0.045",
    "box": "0.05 0.035 0.02",
}
_EYE = np.array([0.70, -0.55, 0.46])  # towards the viewer
_EDGE = 4  # pieces of a curved edge


def outlines(skin: Callable[..., np.ndarray], along: int, around: int) -> list[np.ndarray]:
    """The curved outlines of the patches of a skin."""
    step = np.linspace(0, 1, _EDGE + 1)[:-1]
    zero, one = np.zeros(_EDGE), np.ones(_EDGE)
    u = np.concatenate([step, one, 1 - step, zero])
    v = np.concatenate([zero, step, one, 1 - step])
    return [
        skin(((i + u) / along)[None], ((j + v) / around)[None])[0]
        for i in range(along)
        for j in range(around)
    ]


def main() -> None:
    """Draws the figure and prints how many facets there are."""
    figure = plt.figure(figsize=(8.4, 2.3), dpi=120, layout="none")
    cut = tessellation.patches
    for k, (name, size) in enumerate(SHAPES.items()):
        model = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody><body><freejoint/><geom type='{name}' size='{size}'/></body>"
            "</worldbody></mujoco>"
        )
        drawn: list[np.ndarray] = []

        def watched(
            skin: Callable[..., np.ndarray],
            along: int,
            around: int,
            drawn: list[np.ndarray] = drawn,
        ) -> tessellation.Cells:
            drawn += outlines(skin, along, around)
            return cut(skin, along, around)

        with patch.object(tessellation, "patches", watched):
            facets = facets_from_model(model, [0])
        assert len(facets) == len(drawn)
        seen = facets["normal"] @ _EYE > 0.02
        place = (k / len(SHAPES), -0.02, 1 / len(SHAPES), 0.86)
        axis = figure.add_axes(place, projection="3d", computed_zorder=False)
        axis.add_collection3d(
            Poly3DCollection(
                [outline for outline, front in zip(drawn, seen, strict=True) if front],
                facecolor="#DCE6EE",
                edgecolor="#4A6075",
                linewidth=0.5,
            )
        )
        start = facets["point"][seen] * 1.01
        stop = start + 0.011 * facets["normal"][seen]
        axis.add_collection3d(
            Line3DCollection(list(np.stack([start, stop], 1)), color=ORANGE, lw=0.8, zorder=5)
        )
        half = 0.055
        axis.set(xlim=(-half, half), ylim=(-half, half), zlim=(-half, half))
        axis.set_box_aspect((1, 1, 1), zoom=1.2)
        axis.view_init(elev=27, azim=-38)
        axis.set_axis_off()
        axis.set_title(f"{name}\n{len(facets)} facets", fontsize=9, y=1.0)
        print(f"{name}: {len(facets)} facets")
    save(figure, "facets")


if __name__ == "__main__":
    main()
