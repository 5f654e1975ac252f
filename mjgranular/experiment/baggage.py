"""What workers need that only this process has: laws and media of a user's own, and his files."""

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
from mjgranular.law import Law, get_law, law_in, laws, register_law
from mjgranular.medium import Medium, get_medium, media

_LARGEST = 256 * 2**20  # bytes of a file; chosen
_OURS = "mjgranular"


@dataclass(frozen=True)
class OwnLaw:
    """A law of a user's own.

    Attributes:
        name: it is known by.
        module: that has it.
        kind: name of its class there.
        source: the module's file, for a machine that does not have it; None for one in a package,
            which is to be installed there.
    """

    name: str
    module: str
    kind: str
    source: bytes | None


@dataclass(frozen=True)
class Baggage:
    """What workers need beside an installed mjgranular.

    Attributes:
        laws: of the user's own.
        media: of the user's own, by the names that the experiments have for them.
        files: content of the model's files, by their paths on the machine of origin.
        origin: machine and process that it comes from.
        name: by which a process recognizes it.
    """

    laws: tuple[OwnLaw, ...]
    media: Mapping[str, Medium]
    files: Mapping[Path, bytes]
    origin: tuple[str, int] = field(default_factory=lambda: (socket.gethostname(), os.getpid()))
    name: str = field(default_factory=lambda: secrets.token_hex(8))

    def digest(self) -> str:
        """A sum of all contents: of other files the results would be others."""
        summed = hashlib.sha256()
        for path, content in self.files.items():
            summed.update(f"{path.name}\0{len(content)}\0".encode() + content)
        for law in self.laws:
            summed.update(f"{law.name}\0".encode() + (law.source or b""))
        for name, medium in self.media.items():
            summed.update(f"{name}\0{medium.density}{medium.constants}{medium.grain}".encode())
        return summed.hexdigest()


def pack(study: Study) -> Baggage:
    """Collects what the workers of a study need.

    Raises:
        InputError: a law that is defined where workers cannot get it, or a file that is too large.
    """
    return Baggage(
        laws=tuple(_own_laws(study)),
        media=dict(_own_media(study)),
        files=_files(study.experiment),
    )


def unpack(baggage: Baggage, experiment: Experiment) -> Experiment:
    """Makes laws and media known to this process, and finds the model's files or writes them.

    Returns:
        The experiment, with the place where its model is here.
    """
    if baggage.origin == (socket.gethostname(), os.getpid()):
        return experiment
    for law in baggage.laws:
        if law.name not in laws:
            _learn(law)
    for name, medium in baggage.media.items():
        if name not in media:
            media.add(name, medium)
    model = getattr(experiment, "model", None)
    if not baggage.files or all(_is_here(*file) for file in baggage.files.items()):
        return experiment
    return replace(experiment, model=_written(baggage.files, model))  # pyright: ignore


def _named(study: Study, name: str) -> list[Any]:
    """All values of a field that a study has."""
    varied = study.vary.get(name)
    base = getattr(study.experiment, name)
    return [base] if varied is None else [str(value) for value in varied]  # pyright: ignore


def _own_laws(study: Study) -> Iterable[OwnLaw]:
    kinds: set[type[Law]] = set()
    for text in _named(study, "law"):
        if text is not None:
            kinds.add(law_in(text)[0])
            continue
        for medium in _named(study, "medium"):
            if medium is not None:
                kinds.add(type(get_law(None, get_medium(medium))))
    for kind in sorted(kinds, key=lambda kind: kind.name):
        module = sys.modules.get(kind.__module__)
        if kind.__module__.partition(".")[0] == _OURS:
            continue
        if kind.__module__ == "__main__":
            raise InputError(
                f"the law {kind.name!r} is defined in a script or notebook, where workers do not "
                "find it: put it into a module, a separate file"
            )
        file = Path(getattr(module, "__file__", None) or "")
        alone = "." not in kind.__module__ and file.suffix == ".py" and file.stem != "__init__"
        source = read_file(file, "the module", largest=_LARGEST) if alone else None
        yield OwnLaw(kind.name, kind.__module__, kind.__qualname__, source)


def _learn(law: OwnLaw) -> None:
    """Imports the module of a law; on a machine that lacks it, what came along is written there."""
    what = f"the law {law.module}:{law.kind}"
    try:
        module = import_own(law.module, what)
    except KeyError:
        if law.source is None:
            raise
        folder = _folder()
        (folder / f"{law.module}.py").write_bytes(law.source)
        sys.path.append(str(folder))
        module = import_own(law.module, what)
    file = getattr(module, "__file__", None)
    if law.source is not None and (file is None or not _is_here(Path(file), law.source)):
        raise InputError(
            f"the module {law.module} on {socket.gethostname()} is another than the one here: "
            f"remove it there ({file}), it is sent along"
        )
    if law.name not in laws:
        register_law(getattr(module, law.kind))


def _own_media(study: Study) -> Iterable[tuple[str, Medium]]:
    for name in _named(study, "medium"):
        if name is None:
            continue
        name = str(name).partition(" density=")[0]
        medium = get_medium(name)
        if name not in _SHIPPED or _SHIPPED[name] is not medium:
            yield name, medium


_SHIPPED = dict(media)  # those that the package has registered by now: every worker has them


def _files(experiment: Experiment) -> dict[Path, bytes]:
    """The model's file, and those that it names."""
    model = None if isinstance(experiment, Impact) else experiment.model
    if not isinstance(model, Path):
        return {}
    own = model.absolute()
    content = {own: read_file(own, "the model", largest=_LARGEST)}
    if model.suffix.lower() in (".xml", ".urdf"):
        with loading(model.name):
            named = mujoco.mju_getXMLDependencies(str(model))
        for path in (Path(file).absolute() for file in named):
            content[path] = read_file(path, "a file of the model", largest=_LARGEST)
    return content


def _is_here(path: Path, content: bytes) -> bool:
    try:
        return path.read_bytes() == content
    except OSError:
        return False


def _written(files: Mapping[Path, bytes], model: Path) -> Path:
    """Writes files, as they lie to each other, into a folder of this process; gives the model's."""
    root = _common([*files])
    folder = _folder()
    for path, content in files.items():
        place = folder / path.relative_to(root)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(content)
    return folder / model.absolute().relative_to(root)


def _folder() -> Path:
    """A folder that goes when this process ends."""
    folder = Path(tempfile.mkdtemp(prefix="mjgranular-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _common(paths: list[Path]) -> Path:
    """The innermost folder that all files are in."""
    folder = paths[0].parent
    while not all(path.is_relative_to(folder) for path in paths):
        folder = folder.parent
    return folder
