"""What docs/command-line.md shows as output is what the commands print."""

import json
import re
import shlex
from pathlib import Path

import pytest

from mjgranular.cli import main

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "command-line.md").read_text()
QUOTED = re.findall(r"<!-- mjgranular (.+?) -->\n```text\n(.+?)```", PAGE, re.DOTALL)
MODEL = re.search(r"With `block.xml` as\n\n```xml\n(.+?)```", PAGE, re.DOTALL)[1]


@pytest.fixture
def printed(tmp_path, monkeypatch, capsys):
    """Runs a command beside block.xml; gives standard output and standard error."""
    (tmp_path / "block.xml").write_text(MODEL)
    monkeypatch.chdir(tmp_path)

    def run(command):
        assert main(shlex.split(command)) == 0
        return capsys.readouterr()

    return run


def words(text):
    """Those of a table, without its frame, sorted: headings are broken where there is no room."""
    return sorted(re.sub(r"[^\x20-\x7e]", " ", text).split())


@pytest.mark.parametrize(("command", "quoted"), QUOTED, ids=[command for command, _ in QUOTED])
def test_quoted_outputs_are_what_is_printed(printed, command, quoted):
    out, err = printed(command)
    told = "\n".join(line for line in err.splitlines() if "outside the validity" in line)
    assert words(out + told) == words(quoted)


def last_row(command, printed):
    return json.loads(printed(f"{command} --json")[0])[-1]


@pytest.mark.slow
def test_the_numbers_of_intrude(printed):
    commands = re.findall(r"^mjgranular (intrude.*?)(?: *#.*)?$", PAGE, re.MULTILINE)
    told = [float(n) for n in re.findall(r"([\d.]+) N (?:at|of)", PAGE)]
    plate, drawn, sphere = (
        last_row(re.sub(r"--out \w+", "", command), printed) for command in commands[:3]
    )
    found = (plate["resistance"], drawn["resistance"], drawn["lift"], sphere["resistance"])
    assert [round(number, 1 if number > 100 else 2) for number in found] == told
