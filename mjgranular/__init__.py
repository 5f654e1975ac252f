"""Sand for MuJoCo: published granular resistance laws acting on any MJCF body.

Data flow, and the order in which to read the package: a `Medium` says what the sand is;
`shape` cuts a model's geoms into elements; `surface` gives their depth; a `law` the force on each;
a `scheme` makes a step of it; `Sand` binds them to a model.

SI units, radians, world frame, z up; depth is positive below the surface; forces are on the body.
"""

# First, because MuJoCo reads it once, when it is imported: how to draw.
from mjgranular._util import display as _display

# isort: split

from contextlib import suppress as _suppress
from importlib import import_module as _import_module
from pathlib import Path as _Path
from sys import modules as _modules

from mjgranular._util.display import show as show
from mjgranular._version import __version__ as __version__
from mjgranular.engine import add_sand as add_sand
from mjgranular.errors import GranularError as GranularError
from mjgranular.errors import GranularWarning as GranularWarning
from mjgranular.errors import InputError as InputError
from mjgranular.errors import MissingExtraError as MissingExtraError
from mjgranular.errors import OutputError as OutputError
from mjgranular.errors import RenderError as RenderError
from mjgranular.errors import UnknownNameError as UnknownNameError
from mjgranular.errors import UnstableError as UnstableError
from mjgranular.law import DepthVelocityLaw as DepthVelocityLaw
from mjgranular.law import DistributedLinkLaw as DistributedLinkLaw
from mjgranular.law import DynamicRft2dLaw as DynamicRft2dLaw
from mjgranular.law import DynamicRft3dLaw as DynamicRft3dLaw
from mjgranular.law import Law as Law
from mjgranular.law import LinkLaw as LinkLaw
from mjgranular.law import Rft2dLaw as Rft2dLaw
from mjgranular.law import Rft3dLaw as Rft3dLaw
from mjgranular.law import laws as laws
from mjgranular.law import register_law as register_law
from mjgranular.medium import Medium as Medium
from mjgranular.medium import Quantity as Quantity
from mjgranular.medium import media as media
from mjgranular.medium import register_medium as register_medium
from mjgranular.relief import Heights as Heights
from mjgranular.relief import Memory as Memory
from mjgranular.sand import BodyReport as BodyReport
from mjgranular.sand import Report as Report
from mjgranular.sand import Sand as Sand
from mjgranular.sand import SandSpec as SandSpec
from mjgranular.scheme import Auto as Auto
from mjgranular.scheme import Explicit as Explicit
from mjgranular.scheme import Implicit as Implicit
from mjgranular.scheme import Scheme as Scheme
from mjgranular.scheme import schemes as schemes
from mjgranular.surface import Bed as Bed
from mjgranular.surface import HeightField as HeightField
from mjgranular.surface import Plane as Plane
from mjgranular.surface import Surface as Surface

# `python -m` and `python -c` put the current folder first on the path: in a checkout this package
# then hides the installed one, but lacks `models` and `envs`, which setup.py maps into it.
_package = _Path(__file__).resolve().parent
if not (_package / "models").is_dir() and (_package.parent / "setup.py").is_file():
    __path__.append(str(_package.parent))

if "gymnasium" in _modules:  # register the environments
    with _suppress(ImportError):  # of an extra, or of a release that is too old
        _import_module("mjgranular.envs")
