"""How sand resists: force laws, each with its parameters, its kernel and its citation."""

from mjgranular.law.law import Law as Law
from mjgranular.law.law import get_law as get_law
from mjgranular.law.law import laws as laws
from mjgranular.law.law import register_law as register_law
from mjgranular.law.link import DistributedLinkLaw as DistributedLinkLaw
from mjgranular.law.link import LinkLaw as LinkLaw
