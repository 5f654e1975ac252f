"""`mjgranular list`: media, laws, policies and environments, with their sources."""

import inspect
from dataclasses import MISSING, asdict, dataclass, fields
from functools import partial
from typing import Annotated, Any, Literal

import tyro
from rich.markdown import Markdown

from mjgranular._util.checks import check_name
from mjgranular._util.io import read_json
from mjgranular._util.result_folder import CONFIG
from mjgranular.cli.console import out, print_result, table
from mjgranular.cli.options import Flag, law_named
from mjgranular.errors import UnknownNameError
from mjgranular.law import Law, check_constants, law_in, laws
from mjgranular.learn import policies
from mjgranular.medium import get_medium, media
from mjgranular.sand.spec import has_constants

Listed = tuple[Any, Any]
"""A value for JSON, and what rich prints."""


@dataclass(frozen=True)
class ListCommand:
    """List media, laws, policies or environments; with a name, show one in full.

    Of a medium every value with its source, of a law its parameters, of an environment its
    specification.
    """

    what: Annotated[Literal["media", "laws", "policies", "envs"], tyro.conf.Positional]
    """What to list."""
    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None
    """One of them; or a medium's YAML file, whose names are checked, or my_laws:Mud."""
    json: Flag = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        kinds = {
            "media": (_media, _medium),
            "laws": (_laws, _law),
            "policies": (_policies, _policy),
            "envs": (_environments, _environment),
        }
        every, one = kinds[self.what]
        value, shown = every() if self.name is None else one(self.name)
        print_result(value, partial(out.print, shown), json=self.json)
        return 0


def _media() -> Listed:
    rows = [
        (each.name, each.title, f"{each.density.value:g}", ", ".join(each.laws))
        for each in media.values()
    ]
    headings = ("name", "what it is", "bulk density [kg/m^3]", "laws, its own first")
    return [asdict(medium) for medium in media.values()], table("Media", headings, rows, words=4)


def _medium(name: str) -> Listed:
    medium = get_medium(name)
    check_constants(medium)
    rows = {"density": medium.density}
    if medium.grain is not None:
        rows["grain"] = medium.grain
    for law, constants in medium.constants.items():
        rows |= {f"{law}.{key}": quantity for key, quantity in constants.items()}
    cells = [(key, f"{one.value:g} {one.unit}".strip(), one.source) for key, one in rows.items()]
    title = f"{medium.name}: {medium.title}"
    return asdict(medium), table(title, ("quantity", "value", "source"), cells, words=3)


def _laws() -> Listed:
    rows = [_facts(law) for law in laws.values()]
    headings = ("name", "what it is", "source")
    return rows, table("Laws", headings, [row.values() for row in rows], words=3)


def _law(name: str) -> Listed:
    law = law_in(law_named(name) or "")[0]
    every: Any = fields(law)  # pyright: ignore[reportArgumentType]
    defaults = {f.name: None if f.default is MISSING else f.default for f in every}
    known = {m.name: law.from_medium(m) for m in media.values() if has_constants(m, law)}
    rows = []
    for key, default in defaults.items():
        values = {medium: getattr(made, key) for medium, made in known.items()}
        others = [f"{medium} {value:g}" for medium, value in values.items() if value != default]
        rows.append((key, "" if default is None else f"{default}", ", ".join(others)))
    headings = ("parameter", "default", "media with a value")
    shown = table(f"{law.name}: {law.title}", headings, rows, words=3)
    return {**_facts(law), "parameters": defaults}, shown


def _facts(law: type[Law]) -> dict[str, str]:
    return {"name": law.name, "title": law.title, "citation": law.citation}


def _policies() -> Listed:
    headings, rows = ("name", "environment", "algorithm", "seed", "steps"), []
    for file in sorted(policies.SHIPPED.rglob(CONFIG)):
        run = read_json(file, infinite=True)  # `open_run` imports torch
        name = file.parent.relative_to(policies.SHIPPED).as_posix()
        run = {**run["settings"], **run, "name": name, "steps": run["settings"]["total_steps"]}
        rows.append({heading: run[heading] for heading in headings})
    cells = [map(str, row.values()) for row in rows]
    return rows, table("Policies", headings, cells, words=3)


def _policy(name: str) -> Listed:
    rows = {row["name"]: row for row in _policies()[0]}
    check_name("policy", name, rows)
    row = rows[name]
    return row, table(name, ("", ""), [(key, str(value)) for key, value in row.items()], words=2)


def _environments() -> Listed:
    from mjgranular.envs.ids import id_of
    from mjgranular.envs.task import tasks

    rows = [_environment_row(id_of(name), task) for name, task in tasks.items()]
    cells = [
        (row["id"], row["title"], f"{row['medium']} {row['law']}", str(row["max_episode_steps"]))
        for row in rows
    ]
    headings = ("id", "what it is", "sand and its law", "steps")
    return rows, table("Environments", headings, cells, words=3)


def _environment(identity: str) -> Listed:
    from mjgranular.envs.ids import find_spec, id_of, name_of
    from mjgranular.envs.task import tasks

    name = name_of(identity.rpartition(":")[2])
    if ":" in identity:
        find_spec(identity)  # imports its module, which registers it
    if name not in tasks:
        raise UnknownNameError("environment", identity, map(id_of, tasks))
    row = _environment_row(id_of(name), tasks[name])
    text = inspect.getdoc(tasks[name]) or ""
    return row | {"specification": text}, Markdown(f"# {row['id']}\n\n{text}")


def _environment_row(identity: str, task: Any) -> dict[str, Any]:
    return {
        "id": identity,
        "title": task.title,
        "medium": str(task.medium),
        "law": str(task.law or get_medium(task.medium).default_law),
        "max_episode_steps": task.episode,
    }
