"""The binding of sand to a model, and what it reports."""

from mjgranular.sand.report import BodyReport as BodyReport
from mjgranular.sand.report import Report as Report
from mjgranular.sand.sand import Sand as Sand
from mjgranular.sand.spec import SandSpec as SandSpec
