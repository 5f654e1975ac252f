"""What workers need that only this process has: custom laws and media, and files of a model.

Ray's `runtime_env` would send files too, but only in `ray.init`, not to a session that exists.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import secrets
import shutil
import socket
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco

from mjgranular._util.io import read_file
from mjgranular._util.user_modules import import_own
from mjgranular.errors import InputError
from mjgranular.experiment.drop import loading
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.study import Experiment, Study
from mjgranular.law import get_law, law_in, laws, register_law
from mjgranular.medium import Medium, get_medium, media

_LARGEST = 256 * 2**20  # bytes of a file; chosen
_SHIPPED = dict(media)  # those of the package: every worker has them


@dataclass(frozen=True)
class CustomLaw:
    """A law that is not part of the package.

    Attributes:
        name: its name.
        module: its module.
        kind: name of its class there.
        source: content of the module's file; None for a module of a package, which must be
            installed on other machines.
    """

    name: str
    module: str
    kind: str
    source: bytes | None


@dataclass(frozen=True)
class Baggage:
    """What workers need besides an installed mjgranular.

    Attributes:
        laws: custom laws.
        media: custom media, by their names in the experiments.
        files: content of the model's files, by their paths on the machine of origin.
        origin: machine and process that it comes from.
        name: unique name.
    """

    laws: tuple[CustomLaw, ...]
    media: Mapping[str, Medium]
    files: Mapping[Path, bytes]
    origin: tuple[str, int] = field(default_factory=lambda: (socket.gethostname(), os.getpid()))
    name: str = field(default_factory=lambda: secrets.token_hex(8))

    def digest(self) -> str:
        """Return a digest of all contents, on which results depend."""
        digest = hashlib.sha256()
        for path, content in self.files.items():
            digest.update(f"{path.name}\0{len(content)}\0".encode() + content)
        for law in self.laws:
            digest.update(f"{law.name}\0".encode() + (law.source or b""))
        for name, medium in self.media.items():
            digest.update(f"{name}\0{medium.density}{medium.constants}{medium.grain}".encode())
        return digest.hexdigest()


def pack(study: Study) -> Baggage:
    """Collect what the workers of a study need.

    Raises:
        InputError: a law is defined where workers cannot get it, or a file is too large.
    """
    return Baggage(
        laws=tuple(_custom_laws(study)),
        media=dict(_custom_media(study)),
        files=_files(study.experiment),
    )


def unpack(baggage: Baggage, experiment: Experiment) -> Experiment:
    """Register laws and media in this process, and write the model's files if they are missing.

    Returns:
        The experiment, with the present path of its model.
    """
    if baggage.origin == (socket.gethostname(), os.getpid()):
        return experiment
    for law in baggage.laws:
        if law.name not in laws:
            _register(law)
    for name, medium in baggage.media.items():
        if name not in media:
            media.add(name, medium)
    if all(_is_here(path, content) for path, content in baggage.files.items()):
        return experiment
    assert not isinstance(experiment, Impact)
    assert isinstance(experiment.model, Path)
    return replace(experiment, model=_write(baggage.files, experiment.model.absolute()))


def _values(study: Study, name: str) -> list[Any]:
    """Return all values of a field in a study, except None."""
    varied = study.vary.get(name)
    base = getattr(study.experiment, name)
    values = [base] if varied is None else map(str, varied)  # pyright: ignore
    return [value for value in values if value is not None]


def _custom_laws(study: Study) -> Iterable[CustomLaw]:
    kinds = {law_in(text)[0] for text in _values(study, "law")}
    if "law" not in study.vary and not kinds:
        kinds = {type(get_law(None, get_medium(name))) for name in _values(study, "medium")}
    for kind in sorted(kinds, key=lambda kind: kind.name):
        package, _, within = kind.__module__.partition(".")
        if package == "mjgranular":
            continue
        if package == "__main__":
            raise InputError(
                f"the law {kind.name!r} is defined in a script or notebook, where workers do not "
                "find it: put it into a module, a separate file"
            )
        file = Path(getattr(sys.modules.get(kind.__module__), "__file__", None) or "")
        alone = not within and file.suffix == ".py" and file.stem != "__init__"
        source = read_file(file, "the module", largest=_LARGEST) if alone else None
        yield CustomLaw(kind.name, kind.__module__, kind.__qualname__, source)


def _register(law: CustomLaw) -> None:
    """Register a law; on a machine that lacks its module, write that first."""
    what = f"the law {law.module}:{law.kind}"
    try:
        module = import_own(law.module, what)
    except KeyError:
        if law.source is None:
            raise
        folder = _temporary_folder()
        (folder / f"{law.module}.py").write_bytes(law.source)
        sys.path.append(str(folder))
        module = import_own(law.module, what)
    file = Path(module.__file__ or "")
    if law.source is not None and not _is_here(file, law.source):
        raise InputError(
            f"the module {law.module} on {socket.gethostname()} differs from the one here: "
            f"remove it there ({file}), it is sent along"
        )
    if law.name not in laws:
        register_law(getattr(module, law.kind))


def _custom_media(study: Study) -> Iterable[tuple[str, Medium]]:
    for text in _values(study, "medium"):
        name = str(text).partition(" density=")[0]
        medium = get_medium(name)
        if _SHIPPED.get(name) is not medium:
            yield name, medium


def _files(experiment: Experiment) -> dict[Path, bytes]:
    """Return the content of the model's file, and of those that it refers to."""
    model = None if isinstance(experiment, Impact) else experiment.model
    if not isinstance(model, Path):
        return {}
    content = {model.absolute(): read_file(model.absolute(), "the model", largest=_LARGEST)}
    if model.suffix.lower() in (".xml", ".urdf"):
        with loading(model.name):
            files = mujoco.mju_getXMLDependencies(str(model))
        for path in (Path(file).absolute() for file in files):
            content[path] = read_file(path, "a file of the model", largest=_LARGEST)
    return content


def _is_here(path: Path, content: bytes) -> bool:
    try:
        return path.read_bytes() == content
    except OSError:
        return False


def _write(files: Mapping[Path, bytes], model: Path) -> Path:
    """Write files, in the same relative places, to a temporary folder; return the model's path."""
    root, folder = Path(os.path.commonpath([path.parent for path in files])), _temporary_folder()
    for path, content in files.items():
        place = folder / path.relative_to(root)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    return folder / model.relative_to(root)


def _temporary_folder() -> Path:
    """Make a folder that is deleted when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="mjgranular-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
