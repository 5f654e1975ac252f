"""Geoms become rods; which geoms meet the sand."""

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjgranular import DistributedLinkLaw, Sand


def names(sand):
    model = sand.model
    return {model.geom(int(i)).name for i in np.unique(sand.elements["geom"])}


def test_every_collision_geom_of_a_body_that_moves(chain_model):
    assert names(Sand(chain_model)) == {"trunk", "arm", "spike", "hand", "probe"}


def test_a_body_brings_its_geoms(chain_model):
    assert names(Sand(chain_model, bodies="arm")) == {"arm", "spike"}
    assert names(Sand(chain_model, bodies=["hand", "arm"])) == {"arm", "spike", "hand"}
    assert names(Sand(chain_model, geoms="spike")) == {"spike"}
    assert names(Sand(chain_model, bodies=["hand"], geoms=["arm"])) == {"hand", "arm"}


def test_capsule_from_pole_to_pole_and_cylinder_from_face_to_face(chain_model):
    sand = Sand(chain_model)
    length = {
        chain_model.geom(int(rod["geom"])).name: 2 * rod["half_length"] for rod in sand.elements
    }
    assert length["trunk"] == pytest.approx(2 * (0.1 + 0.012))
    assert length["arm"] == pytest.approx(2 * 0.06)


def test_elements_are_read_only(chain_model):
    with pytest.raises(ValueError, match="read-only"):
        Sand(chain_model).elements["body"] = 1


@given(pieces=st.integers(1, 60))
def test_pieces_cover_the_rod_once(pieces):
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/>"
        "<geom type='capsule' fromto='.1 .2 .3 -.2 .1 .5' size='.01'/>"
        "</body></worldbody></mujoco>"
    )
    (whole,) = Sand(model, law="link").elements
    cut = Sand(model, law=DistributedLinkLaw(1, 1, 1, 1, pieces=pieces)).elements
    assert len(cut) == pieces
    assert cut["half_length"].sum() == pytest.approx(whole["half_length"], rel=1e-12)
    along = (cut["center"] - whole["center"]) @ whole["axis"]
    ends = np.sort(np.concatenate([along - cut["half_length"], along + cut["half_length"]]))
    half = whole["half_length"]
    assert ends[[0, -1]] == pytest.approx([-half, half], rel=1e-12)
    assert ends[1:-1:2] == pytest.approx(ends[2:-1:2], abs=1e-14)
