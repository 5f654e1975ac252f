"""Files that survive a killed process: temporary file, flush, rename; one writer at a time.

The package writes all files with this module. It guarantees four things:

- `atomic_write`: a file has its complete new content, or is unchanged.
- `replace_directory`: several files that belong together appear at once. They wait in a hidden
  folder, and one rename makes them the result; the next process finishes what a killed one began,
  and `latest_path` reads waiting files as if they were in their places.
- `write_folder`: the same for a folder, with checksums that reveal damage.
- `locked`: one process at a time. The system releases the lock when its holder ends.

Errors of the system are raised as `OutputError`.
"""

import errno
import hashlib
import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from mjgranular._util.io import is_plain_name, read_json
from mjgranular.errors import GranularError, OutputError, warn_user

if os.name == "nt":
    import msvcrt
else:
    import fcntl

T = TypeVar("T")

MANIFEST = "manifest.json"
LOCK = ".lock"
_READY = ".publish"  # folder of new files that are not in their places yet
_LIST = "publish.json"  # in it: names of files to remove
_PART, _GONE = ".part", ".gone"
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)
_TRIES = 5


@contextmanager
def atomic_write(file: Path | str) -> Iterator[Path]:
    """Return a path to write to; at the end its content replaces `file` atomically."""
    file = Path(file)
    with _staged(file, file) as part:
        yield part
        _flush(part)
        part.replace(file)
        _flush(file.parent)


def write_text(file: Path, text: str) -> None:
    """Write a UTF-8 text file atomically."""
    with atomic_write(file) as part:
        part.write_bytes(text.encode())


@contextmanager
def replace_directory(folder: Path, *, instead_of: Sequence[str] = ()) -> Iterator[Path]:
    """Return a folder to write files to; at the end all of them are in `folder`, or none."""
    with _staged(folder / _READY, folder) as part:
        part.mkdir()
        yield part
        names = {file.name for file in part.iterdir()}
        stale = [name for name in instead_of if is_plain_name(name) and name not in names]
        (part / _LIST).write_text(json.dumps({"remove": stale}), encoding="utf-8")
        _flush(*part.iterdir(), part)
        finish_publishing(folder)
        part.replace(folder / _READY)  # from here on they are the result
        _flush(folder)
        finish_publishing(folder)


def finish_publishing(folder: Path) -> None:
    """Move files that wait, perhaps of a killed process, to their places; lock the folder first."""
    ready = folder / _READY
    if not ready.is_dir():
        return
    try:
        stale = read_json(ready / _LIST).get("remove")
    except OutputError:  # this one is last: all others are in their places
        stale = None
    for name in stale if isinstance(stale, list) else []:
        if is_plain_name(name):
            (folder / name).unlink(missing_ok=True)
    for file in ready.iterdir():
        if file.name != _LIST:
            file.replace(folder / file.name)
    _flush(folder)
    shutil.rmtree(ready)


def latest_path(folder: Path, name: str) -> Path:
    """Return the path of a file of a folder: in its place, or where it waits."""
    waiting = folder / _READY / name
    return waiting if waiting.exists() else folder / name


def read_consistent(folder: Path, name: str, read: Callable[[], T]) -> T:
    """Read several files of a folder so that all belong to the same result.

    Every result rewrites the file `name`: if it has changed, `read` is called again.
    """

    def state() -> tuple[object, ...]:
        try:
            there = latest_path(folder, name).stat()
        except OSError:
            return (time.monotonic_ns(),) if (folder / _READY).exists() else ()
        return there.st_ino, there.st_mtime_ns, there.st_size

    for tries in range(1, _TRIES + 1):
        before, moving = state(), (folder / _READY).exists()
        try:
            found = read()
        except OutputError:
            if tries == _TRIES or (state() == before and not moving):
                raise
        else:
            if state() == before:
                return found
        time.sleep(0.02)
    raise OutputError(f"{folder} is being written by another process: try again when that is done")


def write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Write a folder atomically, with a manifest of sizes and SHA-256 sums."""
    with _staged(folder, folder) as part:
        part.mkdir(parents=True)
        fill(part)
        manifest = {
            file.name: {"bytes": file.stat().st_size, "sha256": _sum(file)}
            for file in sorted(part.iterdir())
        }
        (part / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        _flush(*part.iterdir(), part)
        gone = folder.with_name(f".{folder.name}{_GONE}")
        shutil.rmtree(gone, ignore_errors=True)
        if folder.exists():
            folder.replace(gone)
        part.replace(folder)
        _flush(folder.parent)
        shutil.rmtree(gone, ignore_errors=True)


def remove_folder(folder: Path) -> None:
    """Remove a folder so that a partly removed one is never taken for a complete one."""
    if folder.exists():
        gone = _temporary(folder)
        folder.replace(gone)
        shutil.rmtree(gone, ignore_errors=True)


def find_corruption(folder: Path, names: Sequence[str] = ()) -> str | None:
    """Find what is wrong with a folder of `write_folder` that must have these files; else None."""
    try:
        manifest = read_json(folder / MANIFEST)
        for name in (*manifest, *names):
            file = folder / name
            if name not in manifest:
                return f"{MANIFEST} lacks {name}"
            if not is_plain_name(name) or not file.is_file():
                return f"{name} is missing"
            entry = manifest[name]
            if file.stat().st_size != entry["bytes"] or _sum(file) != entry["sha256"]:
                return f"{name} is not as it was written"
    except OutputError as error:
        return str(error)
    except OSError as error:
        return f"it cannot be read ({error.strerror or error})"
    except (ValueError, KeyError, TypeError):
        return f"{MANIFEST} is damaged"
    return None


def remove_leftovers(folder: Path, names: Sequence[str] | None = None) -> None:
    """Remove partly written files of killed processes (None: all); the folder must be locked."""
    mine = {_READY[1:], *(names or ())}
    for path in list(folder.glob(".*")):
        name = path.name.lstrip(".")  # two for a part of a part
        is_part, is_old = _PART in name, name.endswith(_GONE)
        owner = name.partition(_PART)[0] if is_part else name.removesuffix(_GONE)
        if not (is_part or is_old) or (names is not None and owner not in mine):
            continue
        if not is_part and not (folder / owner).exists():
            path.replace(folder / owner)  # killed between two renames: the old one is the newest
        else:
            _remove(path)


@contextmanager
def locked(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Keep other processes out of a folder, which is made if it does not exist.

    Lock before reading what is to be changed, not only before writing. A folder in use, or one that
    cannot be written to, is an error; a file system without locks gives a warning.
    """
    file = folder / name
    try:
        descriptor = _lock(file)
    except BlockingIOError:
        raise OutputError(
            f"{folder} is in use by another process: wait for it, or use another with --out"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise OutputError(
                f"cannot write to {folder}: {error.strerror or error}; choose a writable folder"
            ) from None
        warn_user(f"the file system of {folder} has no locks: let no other process write there")
        yield
        return
    try:
        yield
    finally:
        if os.name == "nt":  # where an open file cannot be removed
            os.close(descriptor)
        with suppress(OSError):
            file.unlink()
        if os.name != "nt":
            os.close(descriptor)


def _lock(file: Path) -> int:
    """Open and lock a file; raise `BlockingIOError` if another process has it."""
    tries = 0
    while True:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:  # the previous holder removed the folder that it had made
            tries += 1
            if tries == _TRIES:
                raise
            continue
        try:
            if os.name == "nt":
                try:
                    msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
                except OSError:
                    raise BlockingIOError from None
                return descriptor
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The previous holder removes the file: a lock on a removed file is void.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(descriptor), file.stat()):
                    return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


@contextmanager
def _staged(path: Path, target: Path) -> Iterator[Path]:
    """Return a hidden path next to a path, for what is renamed to it; removed at the end."""
    part = _temporary(path)
    try:
        yield part
    except GranularError:
        raise
    except OSError as error:
        raise OutputError(f"cannot write {target}: {error.strerror or error}") from None
    finally:
        _remove(part)


def _temporary(path: Path) -> Path:
    """Return a hidden path with the same suffix, by which writers choose the format."""
    return path.with_name(f".{path.name}{_PART}{secrets.token_hex(4)}{path.suffix}")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


def _flush(*paths: Path) -> None:
    for path in paths:
        if os.name == "nt" and path.is_dir():
            continue  # folders cannot be opened on this system
        descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _sum(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
