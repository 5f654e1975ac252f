"""Force laws, each with its parameters, its kernel and its citation."""

from mjgranular.law.depth_velocity import DepthVelocityLaw as DepthVelocityLaw
from mjgranular.law.dynamic import DynamicRft2dLaw as DynamicRft2dLaw
from mjgranular.law.dynamic import DynamicRft3dLaw as DynamicRft3dLaw
from mjgranular.law.law import Law as Law
from mjgranular.law.law import check_constants as check_constants
from mjgranular.law.law import get_law as get_law
from mjgranular.law.law import law_in as law_in
from mjgranular.law.law import laws as laws
from mjgranular.law.law import make_scene as make_scene
from mjgranular.law.law import register_law as register_law
from mjgranular.law.link import DistributedLinkLaw as DistributedLinkLaw
from mjgranular.law.link import LinkLaw as LinkLaw
from mjgranular.law.rft2d import Rft2dLaw as Rft2dLaw
from mjgranular.law.rft3d import Rft3dLaw as Rft3dLaw
from mjgranular.law.validity import Finding as Finding
from mjgranular.law.validity import Limit as Limit
from mjgranular.law.validity import Standing as Standing
