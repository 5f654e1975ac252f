"""`mjgranular envs`: the environments there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from rich.markdown import Markdown
from rich.table import Table

from mjgranular.cli.console import out, print_json
from mjgranular.errors import UnknownNameError
from mjgranular.medium import get_medium


@dataclass(frozen=True)
class EnvsCommand:
    """The Gymnasium environments there are; with an id, the specification of one."""

    id: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[ID]")] = None
    """An environment, such as mjgranular/ChainSwim-v0 or ChainSwim."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Runs the command."""
        from mjgranular.envs.ids import id_of, name_of
        from mjgranular.envs.known import find_spec
        from mjgranular.envs.tasks import tasks

        if self.id is not None:
            name = name_of(self.id.rpartition(":")[2])
            if ":" in self.id:
                find_spec(self.id)  # has its module imported, which registers it
            if name not in tasks:
                raise UnknownNameError("environment", self.id, map(id_of, tasks))
            row = _row(id_of(name), tasks[name])
            if self.json:
                print_json(row | {"specification": _text(tasks[name])})
            else:
                out.print(Markdown(f"# {row['id']}\n\n{_text(tasks[name])}"))
            return 0
        rows = [_row(id_of(name), task) for name, task in tasks.items()]
        if self.json:
            print_json(rows)
            return 0
        table = Table(title="Environments", title_justify="left")
        table.add_column("id", no_wrap=True)
        table.add_column("what it is")
        table.add_column("sand and its law", min_width=16)
        table.add_column("steps", justify="right")
        for row in rows:
            sand = f"{row['medium']} {row['law']}"
            table.add_row(row["id"], row["title"], sand, str(row["max_episode_steps"]))
        out.print(table)
        return 0


def _row(identity: str, task: Any) -> dict[str, Any]:
    return {
        "id": identity,
        "title": task.title,
        "medium": str(task.medium),
        "law": str(task.law or get_medium(task.medium).default_law),
        "max_episode_steps": task.episode,
    }


def _text(task: Any) -> str:
    import inspect

    return inspect.getdoc(task) or ""
