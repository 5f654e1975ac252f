"""An experiment as one row of a table: plain numbers and names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mjgranular.experiment.drop import DropResult, run_drop
from mjgranular.experiment.fall import run_impact
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.intrusion import Intrusion, IntrusionResult, run_intrusion
from mjgranular.experiment.study import Experiment, Value, column_of, value_in_table, with_values

Row = dict[str, Any]


def row_of(experiment: Experiment, values: Mapping[str, Value]) -> Row:
    """Runs one experiment of a study; its values come first.

    Args:
        experiment: what is common to all.
        values: of the fields that are varied.
    """
    mine = with_values(experiment, values)
    asked = {column_of(name): value_in_table(name, value) for name, value in values.items()}
    if isinstance(mine, Impact):
        found = run_impact(mine).summary()
    elif isinstance(mine, Intrusion):
        found = intrusion_row(run_intrusion(mine))
    else:
        found = drop_row(run_drop(mine))
    return {**asked, **{name: value for name, value in found.items() if name not in asked}}


def drop_row(result: DropResult) -> Row:
    """The summary of a run of a model, of all its bodies together and of each."""
    summary = result.summary()
    bodies = summary.pop("bodies")
    held = [body["within_validity"] for body in bodies if body["within_validity"] is not None]
    row = {
        **summary,
        "greatest_depth": max(body["greatest_depth"] for body in bodies),
        "greatest_force": max(body["greatest_force"] for body in bodies),
        "energy_into_sand": sum(body["energy_into_sand"] for body in bodies),
        "within_validity": min(held, default=None),
    }
    for body in bodies:
        name = body.pop("body")
        exceeded = body.pop("exceeded")
        row |= {f"{name}: {key}": value for key, value in body.items()}
        row |= {f"{name}: {measure} reached": value for measure, value in exceeded.items()}
    return row


def intrusion_row(result: IntrusionResult) -> Row:
    """Force on an intruder at the end of its path, the greatest on it, and the work done."""
    resistance, lift, sideways = result.force.T
    greatest = int(resistance.argmax())
    steps = np.diff(result.travelled)
    return {
        "law": result.law,
        "medium": result.intrusion.medium,
        "elements": result.elements,
        "travelled": float(result.travelled[-1]),
        "final_depth": float(result.depth[-1]),
        "resistance": float(resistance[-1]),
        "lift": float(lift[-1]),
        "sideways": float(sideways[-1]),
        "greatest_resistance": float(resistance[greatest]),
        "depth_of_greatest": float(result.depth[greatest]),
        "work": float(((resistance[1:] + resistance[:-1]) / 2 * steps).sum()),
        "within_validity": float(result.valid.mean()),
    }
