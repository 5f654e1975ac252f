"""Writing that survives a killed process: beside, flushed to the disk, renamed."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mjgranular.errors import OutputError

MANIFEST = "manifest.json"


def write_text(file: Path, text: str) -> None:
    """Writes a text file whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    write_bytes(file, text.encode())


def write_bytes(file: Path, content: bytes) -> None:
    """Writes a file whole or not at all.

    Raises:
        OutputError: it cannot be written.
    """
    part = file.with_name(f".{file.name}.part{os.getpid()}")
    try:
        part.write_bytes(content)
        _flush(part)
        part.replace(file)
        _flush(file.parent)
    except OSError as error:
        raise OutputError(f"cannot write {file}: {error.strerror or error}") from None
    finally:
        with suppress(OSError):
            part.unlink()


def write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Writes a folder whole or not at all, with a manifest of sizes and SHA-256 sums.

    Args:
        folder: replaced if it is there.
        fill: writes files into the folder it is given.

    Raises:
        OutputError: it cannot be written.
    """
    part = folder.with_name(f".{folder.name}.part{os.getpid()}")
    try:
        part.mkdir(parents=True)
        fill(part)
        manifest = {
            file.name: {"bytes": file.stat().st_size, "sha256": _sum(file)}
            for file in sorted(part.iterdir())
        }
        (part / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        for file in part.iterdir():
            _flush(file)
        _flush(part)
        remove_folder(folder)
        part.replace(folder)
        _flush(folder.parent)
    except OSError as error:
        raise OutputError(f"cannot write {folder}: {error.strerror or error}") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Removes a folder so that a half removed one is never taken for a whole one."""
    if folder.exists():
        gone = folder.with_name(f".{folder.name}.gone{os.getpid()}")
        folder.replace(gone)
        shutil.rmtree(gone, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Removes what killed processes left half written; the folder must be locked."""
    for path in folder.glob(".*"):
        if ".part" in path.name or ".gone" in path.name:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def fault(folder: Path) -> str | None:
    """What is wrong with a folder written by `write_folder`; None if nothing is."""
    try:
        manifest: dict[str, Any] = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        for name, entry in manifest.items():
            file = folder / name
            if not file.is_file():
                return f"{name} is missing"
            if file.stat().st_size != entry["bytes"] or _sum(file) != entry["sha256"]:
                return f"{name} is not as it was written"
    except OSError as error:
        return f"{MANIFEST} cannot be read ({error.strerror or error})"
    except (ValueError, KeyError, TypeError, AttributeError):
        return f"{MANIFEST} is damaged"
    return None


def _flush(path: Path) -> None:
    """Has the system write a file or folder to the disk."""
    if path.is_dir() and os.name == "nt":
        return  # folders cannot be opened there
    descriptor = os.open(path, os.O_RDONLY if os.name != "nt" else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _sum(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
