"""Read untrusted media files: mutated, huge, nested, or not files at all."""

from __future__ import annotations

import json
import re
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from random import Random

from attacks import untrusted
from attacks.untrusted import CANARY
from attacks.worker import Case, Note, Result

from mjgranular.cli import main
from mjgranular.law import get_law
from mjgranular.medium import get_medium
from mjgranular.medium.file import EXAMPLE

VALUES = (
    "", "~", "null", "true", "no", "1e400", "-1e400", ".nan", ".inf", "-.Inf", "nan",
    "0x7fffffff", "010", "1_0", "1:2:3", "1:30.5", "9" * 400, "9" * 5000, "0x" + "f" * 3000, "-0",
    "2023-99-99", "2001-02-31T25:61:61Z", "0000-00-00", "[1500]", "[]", "{}", "{a: {b: c}}",
    "*nowhere", "*a", "&a 5", "&a [1, *a]", "<<", "? x", "- - - x", "!!float 3", "!!binary aGk=",
    "!!timestamp x", "!!set {a, b}", "!!omap [a: 1]", "!!python/none x",
    "!!python/name:os.system", "!!python/object/apply:os.system [touch " + CANARY + "]",
    "!!python/object/new:subprocess.Popen [[touch, " + CANARY + "]]", "! x", "!<tag:x> y",
    "|\n  a\n", ">-\n  a\n   b\n", "'", '"', '"\\x00"', '"\\e[31mred"', '"\\u202e"', '"\\ud800"',
    "[/bold]", "%s%n", "{value: {value: {value: 1}}}", "\t", "@", "`", "é" * 200, "x" * 1999,
    "x" * 3000, "\u2028", ":",
)  # fmt: skip
"""Replacements for a word of a file."""

KINDS = ("pipe", "zero", "folder", "loop", "sparse", "missing", "long", "null", "unreadable")
"""Replacements for a file."""


def cases(options: Namespace, numbers: range) -> list[Case]:
    """List cases; each depends on those before it."""
    random = Random(options.seed)
    return [make_case(random) for _ in range(numbers.stop)][numbers.start :]


def make_case(random: Random) -> Case:
    """Draw a case: a replacement of a file, or its bytes, each as a character."""
    if random.random() < 0.08:
        return {"kind": random.choice(KINDS)}
    content = (_bomb if random.random() < 0.25 else _mutant)(random)
    return {"kind": "file", "content": content.decode("latin-1")}


def prepare() -> None:
    """Load what the first case would, and check that a valid file is accepted."""
    read({"kind": "file", "content": EXAMPLE})
    untrusted.guard()


def attempt(case: Case, _note: Note) -> Result:
    """Read a case."""
    return untrusted.read(lambda: read(case), json.dumps(case))


def read(case: Case) -> str:
    """Read the file, make its law, and list it with the command."""
    path = put_file(case)
    try:
        medium = get_medium(path)
    except Exception:
        assert main(["list", "media", path]) == 2
        raise
    # Each law checks its constants: names and values may still be wrong.
    shown = {main(["list", "media", path, *form]) for form in ([], ["--json"])}
    assert shown in ({0}, {2})
    return f"{medium.name} {get_law(None, medium)}"[:500]


def put_file(case: Case) -> str:
    """Make the file of a case, and return its path."""
    path = Path("stranger.yaml")
    if case["kind"] == "file":
        untrusted.remove(path)
        path.write_bytes(case["content"].encode("latin-1"))
    else:
        untrusted.put_special(path, case["kind"])
    return {"long": "x" * 5000 + ".yaml", "null": "a\0b.yaml"}.get(case["kind"], str(path))


def _mutant(random: Random) -> bytes:
    """Mutate the example."""
    text = EXAMPLE + "grain: {value: 0.0003, unit: m, source: sieved}\n"
    changes: list[Callable[[str, Random], str]] = [*[_word] * 2, *[_value] * 2, _lines, _letters]
    for _ in range(random.choice((1, 1, 2, 4))):
        text = random.choice(changes)(text, random)
    content = text.encode("utf-8", "surrogatepass")
    if random.random() < 0.1:
        content = text.encode(random.choice(("utf-16", "utf-32", "utf-8-sig")), "surrogatepass")
    for _ in range(random.choice((0, 0, 0, 1, 5))):
        at = random.randrange(len(content))
        content = content[:at] + random.randbytes(random.choice((1, 1, 3))) + content[at + 1 :]
    return content


def _word(text: str, random: Random) -> str:
    """Replace a word."""
    words = list(re.finditer(r"[^\s:{},]+", text))
    found = random.choice(words)
    return text[: found.start()] + random.choice(VALUES) + text[found.end() :]


def _value(text: str, random: Random) -> str:
    """Replace a value after a colon."""
    found = random.choice(list(re.finditer(r"(?<=: )[^,}\n]+", text)) or [re.match("", text)])
    assert found is not None
    return text[: found.start()] + random.choice(VALUES) + text[found.end() :]


def _lines(text: str, random: Random) -> str:
    """Delete, copy, indent or add a line."""
    lines = text.split("\n")
    at = random.randrange(len(lines))
    kind = random.randrange(4)
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(random.randrange(len(lines)), lines[at])
    elif kind == 2:
        lines[at] = " " * random.randrange(9) + lines[at]
    else:
        strange = ("---", "...", "%YAML 9.9", "- x", "? y", "# z", "a: &b {c: d}")
        lines.insert(at, random.choice(strange))
    return "\n".join(lines)


def _letters(text: str, random: Random) -> str:
    """Delete or insert some characters."""
    for _ in range(random.randrange(1, 6)):
        at = random.randrange(len(text) + 1)
        put = random.choice(("", *"{}[]&*!%'\":-\x1b"))
        text = text[:at] + put + text[at + random.randrange(2) :]
    return text


def _bomb(random: Random) -> bytes:
    """Write something that grows when it is read."""
    size = random.choice((100, 2000, 20_000, 99_000, 150_000, 2_000_000))
    width = random.randrange(2, 12)
    levels = min(size // (5 * width), 60)
    laughs = ["a0: &a0 [" + ",".join(["x"] * width) + "]"]
    laughs += [f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * width)}]" for i in range(1, levels)]
    merges = ["m0: &m0 {x: 1}"]
    merges += [
        f"m{i}: &m{i} {{<<: [{','.join([f'*m{i - 1}'] * width)}]}}" for i in range(1, levels)
    ]
    bombs = (
        "\n".join([*laughs, EXAMPLE]),
        "\n".join([*merges, EXAMPLE]),
        EXAMPLE.replace("1500", "&b " + "1" * min(size, 50_000))
        + f"grain: [{'*b,' * (size // 4)}]",
        "[" * size,
        "{a: " * (size // 4),
        "- " * (size // 2),
        "? " * (size // 2),
        "[" + "[]," * (size // 3) + "]",
        "{" + ",".join(f"k{i}" for i in range(size // 7)) + "}",
        "\n".join(f"k{i}: {{}}" for i in range(size // 10)),
        EXAMPLE.replace("my_sand", "x" * size),
        EXAMPLE.replace("my_sand", '"' + "\\x41" * (size // 4) + '"'),
        EXAMPLE.replace("1500", "9" * size),
        EXAMPLE.replace("1500", "1:" * (size // 2) + "1"),
        EXAMPLE + "".join(f"    k{i}: {{value: 1, source: x}}\n" for i in range(size // 32)),
        "&" + "a" * size + " x",
        "%TAG ! " + "a" * size + "\n---\nx",
        "\n" * size,
        "|\n" + " a\n" * (size // 3),
        "\x00" * size,
    )
    return random.choice(bombs).encode()
