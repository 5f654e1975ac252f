"""Poses that are no number, over a height field large enough that an index of them leads astray."""

from itertools import product

import pytest

SCRIPT = """
from functools import cache
import mujoco
import numpy as np
from mjgranular import GranularError, HeightField, Sand
from mjgranular.engine import add_sand

TEXT = (
    '<mujoco><asset><hfield name="h" nrow="2000" ncol="2000" size="1 1 .1 .1"/></asset>'
    '<worldbody><geom name="hf" type="hfield" hfield="h"/><body mocap="true"><body>'
    '<joint axis="0 1 0"/><geom type="capsule" size=".05 .1"/></body></body>'
    '<body pos=".1 .1 0"><freejoint/><geom type="capsule" size=".05 .1"/></body>'
    '</worldbody></mujoco>'
)


def run(door, scheme, law, line):
    given = {"surface": HeightField("hf"), "law": law, "scheme": scheme}
    given["medium"] = "quikrete_medium" if law == "rft3d" else "play_sand"
    if door == "plugin":
        spec = mujoco.MjSpec.from_string(TEXT)
        add_sand(spec, **given)
        model = spec.compile()
        del spec  # its heights would lie where a wrong index leads, and be read without a fault
    else:
        model = mujoco.MjModel.from_xml_string(TEXT)
        sand = Sand(model, **given)
    data = mujoco.MjData(model)
    exec(line)
    try:
        for _ in range(2):
            if door == "plugin":
                mujoco.mj_step(model, data)
            elif door == "report":
                sand.report(data)
            else:
                sand.step(data)
    except (GranularError, mujoco.FatalError):
        return "announced"
    finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
    heard = door != "report" and data.warning.number.any()
    return "announced" if heard else "fine" if finite else "silent"
"""
LINES = (
    *(f"data.mocap_pos[0, :2] = {value}" for value in ("np.nan", "-np.inf", "1e300")),
    *(f"data.qpos[{where}] = np.nan" for where in ("1", ":")),
    "model.body_pos[1:] = np.nan",
    "model.hfield_data[:] = np.nan",
)


DOORS = ("step", "plugin", "report")
SANDS = (("implicit", "rft3d"), ("explicit", "link_distributed"))


@pytest.mark.slow
def test_a_body_that_is_nowhere(survive):
    cases = [(door, *sand, line) for door, sand, line in product(DOORS, SANDS, LINES)]
    found = dict(zip(cases, survive(SCRIPT, cases), strict=True))
    # A report of a pose that is no number need not warn.
    assert not [case for case, text in found.items() if text == "silent" and case[0] != "report"]
