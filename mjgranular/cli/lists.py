"""`mjgranular media`, `mjgranular laws`, `mjgranular policies`: what there is, with sources."""

from __future__ import annotations

from dataclasses import MISSING, asdict, dataclass, fields
from typing import Annotated, Any

import tyro
from rich.table import Table
from rich.text import Text

from mjgranular.cli.console import out, print_json
from mjgranular.cli.options import law_named
from mjgranular.law import Law, check_constants, law_in, laws
from mjgranular.medium import Medium, get_medium, media
from mjgranular.sand.material import has_constants


@dataclass(frozen=True)
class MediaCommand:
    """The media there are; with a name, every value of that medium with its source."""

    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[NAME]")] = None
    """A medium, or a YAML file of your own, whose names are checked."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        if self.name is not None:
            medium = get_medium(self.name)
            check_constants(medium)
            _show_medium(medium, as_json=self.json)
        elif self.json:
            print_json([asdict(medium) for medium in media.values()])
        else:
            table = Table(title="Media", title_justify="left")
            for heading in ("name", "what it is", "bulk density [kg/m^3]", "laws, its own first"):
                table.add_column(Text(heading))
            for medium in media.values():
                density = f"{medium.density.value:g}"
                table.add_row(medium.name, medium.title, density, ", ".join(medium.laws))
            out.print(table)
        return 0


def _show_medium(medium: Medium, *, as_json: bool) -> None:
    if as_json:
        print_json(asdict(medium))
        return
    table = Table(title=f"{medium.name}: {medium.title}", title_justify="left")
    table.add_column("quantity", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("source")
    rows = {"density": medium.density}
    if medium.grain is not None:
        rows["grain"] = medium.grain
    for law, constants in medium.constants.items():
        rows |= {f"{law}.{key}": quantity for key, quantity in constants.items()}
    for key, quantity in rows.items():
        table.add_row(key, f"{quantity.value:g} {quantity.unit}".strip(), quantity.source)
    out.print(table)


@dataclass(frozen=True)
class LawsCommand:
    """The force laws there are, with their sources; with a name, the parameters of one."""

    name: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[LAW]")] = None
    """A law, or my_laws:Mud for one of your own."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        if self.name is not None:
            self._show(law_in(law_named(self.name) or "")[0])
            return 0
        rows = [_facts(law) for law in laws.values()]
        if self.json:
            print_json(rows)
            return 0
        table = Table(title="Laws", title_justify="left")
        table.add_column("name", no_wrap=True)
        table.add_column("what it is")
        table.add_column("source")
        for row in rows:
            table.add_row(*row.values())
        out.print(table)
        return 0

    def _show(self, law: type[Law]) -> None:
        """Prints the parameters of a law: its fields."""
        every: Any = fields(law)  # pyright: ignore[reportArgumentType]
        parameters = {
            field.name: None if field.default is MISSING else field.default for field in every
        }
        if self.json:
            print_json({**_facts(law), "parameters": parameters})
            return
        table = Table(title=f"{law.name}: {law.title}", title_justify="left")
        table.add_column("parameter", no_wrap=True)
        table.add_column("default", justify="right")
        table.add_column("media with a value")
        of_media = {
            medium.name: law.from_medium(medium)
            for medium in media.values()
            if has_constants(medium, law)
        }
        for name, default in parameters.items():
            known = [
                f"{medium} {getattr(made, name):g}"
                for medium, made in of_media.items()
                if getattr(made, name) != default
            ]
            table.add_row(name, "" if default is None else f"{default}", ", ".join(known))
        out.print(table)


def _facts(law: type[Law]) -> dict[str, str]:
    return {"name": law.name, "title": law.title, "citation": law.citation}


@dataclass(frozen=True)
class PoliciesCommand:
    """The trained policies that come with the package."""

    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        from mjgranular.learn.policies import last_return, shipped_policies

        rows = [
            {
                "name": name,
                "environment": run.environment,
                "algorithm": run.settings.algorithm,
                "seed": run.seed,
                "steps": run.settings.total_steps,
                "mean_return": last_return(run),
            }
            for name, run in shipped_policies().items()
        ]
        if self.json:
            print_json(rows)
            return 0
        if not rows:
            out.print("none yet: mjgranular train ENV makes one")
            return 0
        table = Table(title="Policies", title_justify="left")
        for heading in ("name", "environment", "algorithm", "seed", "steps", "return at the end"):
            table.add_column(Text(heading), no_wrap=heading == "name")
        for row in rows:
            *cells, reached = row.values()
            table.add_row(*map(str, cells), "" if reached is None else f"{reached:.4g}")
        out.print(table)
        return 0
