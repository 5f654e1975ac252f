"""What a study needs besides an installed mjgranular: files of a model, custom laws and media."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco

from mjgranular._util.io import read_file
from mjgranular.errors import InputError
from mjgranular.experiment.drop import loading
from mjgranular.experiment.impact import Impact
from mjgranular.experiment.study import Experiment, Study
from mjgranular.law import Law, law_in, laws, register_law
from mjgranular.medium import Medium, get_medium, media
from mjgranular.models import robot_path

_LARGEST = 256 * 2**20  # bytes of a file; chosen
_SHIPPED = dict(media)  # those of the package: every worker has them


@dataclass(frozen=True)
class Custom:
    """Laws and media that are not part of the package; can be sent to workers.

    Attributes:
        laws: classes, which workers import from the modules that define them.
        media: by name.
    """

    laws: tuple[type[Law], ...]
    media: Mapping[str, Medium]

    @classmethod
    def of(cls, study: Study) -> Custom:
        """Return what a study uses; a law defined where workers cannot import it is an error."""
        names = {text.partition(" density=")[0] for text in _words(study, "medium")}
        used = {name: get_medium(name) for name in sorted(names)}
        others = {name: one for name, one in used.items() if _SHIPPED.get(name) is not one}
        return cls(tuple(_laws(study)), others)

    def register(self) -> None:
        """Register the laws and media in this process."""
        for law in self.laws:
            if law.name not in laws:
                register_law(law)
        for name, medium in self.media.items():
            media.add(name, medium, replace=True)


def _laws(study: Study) -> Iterator[type[Law]]:
    """Yield the laws that a study uses and that are not part of the package."""
    kinds = {law_in(text)[0].name: law_in(text)[0] for text in _words(study, "law")}
    for kind in kinds.values():
        package = kind.__module__.partition(".")[0]
        if package == "__main__":
            raise InputError(
                f"the law {kind.name!r} is defined in a script or notebook, where workers do not "
                "find it: put it into a module, a separate file"
            )
        if package != "mjgranular":
            yield kind


def _words(study: Study, name: str) -> list[str]:
    """Return all values of a field in a study, except None."""
    values: Any = study.vary.get(name, [getattr(study.experiment, name)])
    return [str(value) for value in values if value is not None]


def digest(study: Study) -> str:
    """Return a digest of the files, laws and media on which the results of a study depend."""
    custom, digest = Custom.of(study), hashlib.sha256()
    modules = [Path(sys.modules[law.__module__].__file__ or "") for law in custom.laws]
    for path in [*_files(study.experiment), *modules]:
        content = read_file(path, "a file of the study", largest=_LARGEST)
        digest.update(f"{path.name}\0{len(content)}\0".encode() + content)
    for name, medium in custom.media.items():
        digest.update(f"{name}\0{medium}".encode())
    return digest.hexdigest()


def _files(experiment: Experiment) -> list[Path]:
    """Return the model's file, and those that it refers to."""
    if isinstance(experiment, Impact) or experiment.model is None:
        return []
    model = robot_path(experiment.model)
    if model.suffix.lower() not in (".xml", ".urdf"):
        return [model]
    with loading(model.name):
        return [model, *(Path(file) for file in mujoco.mju_getXMLDependencies(str(model)))]
