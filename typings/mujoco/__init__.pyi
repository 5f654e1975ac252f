# MuJoCo 4.0 ships no types for its compiled modules, so a type checker sees none of its names.
# Here every name is there, of no particular type.
from typing import Any

def __getattr__(name: str) -> Any: ...
