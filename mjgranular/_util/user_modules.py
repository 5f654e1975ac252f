"""Custom modules, named by the user as in `my_quad:MyQuad-v0` or `my_laws:Drag`.

A module named so is executed. Pass only names from the user here, never from a file.
"""

import importlib
import sys
from pathlib import Path
from types import ModuleType

from mjgranular.errors import InputError, UnknownNameError


def import_own(name: str, what: str) -> ModuleType:
    """Import a module that is installed, or is in the current folder.

    The current folder is searched last, so that nothing in it shadows an installed module. It stays
    in `sys.path`: the module may import its neighbors later, and spawned processes find the module
    there. `what` it is imported for is named in messages: "the environment my_quad:MyQuad-v0".
    """
    if not all(part.isidentifier() for part in name.split(".")):
        raise InputError(
            f"the module {name!r} of {what} cannot be imported: name it as in an import, my_module"
        )
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or name
        if name == missing or name.startswith(f"{missing}."):
            near = sorted(path.stem for path in Path(here).glob("*.py"))
            searched = f"what is installed, and the current folder, {here}"
            hint = f"for {what} was searched: {searched}"
            raise UnknownNameError("module", missing, near, hint) from None
        reason = f"it needs {missing}, which is not installed"
    except SystemExit:
        reason = "it ends the program; what it is to do as a script belongs under "
        reason += 'if __name__ == "__main__"'
    except Exception as error:  # any module may come here
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    raise InputError(f"the module {name!r} of {what} cannot be imported: {reason}")
