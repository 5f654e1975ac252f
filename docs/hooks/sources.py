"""The package as it is installed, for the reference: in a checkout `envs` lies beside it."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority

_ROOT = Path(__file__).resolve().parents[2]
_FOLDER = tempfile.TemporaryDirectory()  # removed at exit


@event_priority(100)  # before mkdocstrings reads it
def on_config(config: MkDocsConfig) -> None:
    """Called by MkDocs with its configuration: has mkdocstrings read a copy, put together."""
    package = Path(_FOLDER.name) / "mjgranular"
    for source, place in (("mjgranular", "."), ("envs", "envs"), ("models", "models")):
        shutil.copytree(
            _ROOT / source,
            package / place,
            ignore=lambda _, names: [
                name
                for name in names
                if (Path(name).suffix != ".py" and "." in name) or name == "__pycache__"
            ],
            dirs_exist_ok=True,
        )
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [_FOLDER.name]
