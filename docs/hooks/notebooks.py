"""Notebooks as pages: text as it is, code and its saved outputs, with nothing run.

They are executed by `python docs/notebooks/execute.py`, and by a test.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Called by MkDocs with all files: each notebook gets a page beside it, of the same name."""
    for file in list(files):
        if file.src_uri.endswith(".ipynb") and file.abs_src_path:
            notebook = json.loads(Path(file.abs_src_path).read_text(encoding="utf-8"))
            page = file.src_uri.removesuffix(".ipynb") + ".md"
            link = f'<a href="{Path(file.src_uri).name}" download>Download this notebook</a>'
            parts = [_cell(cell) for cell in notebook["cells"]]
            files.append(File.generated(config, page, content="\n\n".join([*parts, link])))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Called by MkDocs with the text of a page: links to notebooks lead to their pages."""
    return re.sub(r"\]\(([^)]+)\.ipynb\)", r"](\1.md)", markdown)


def _cell(cell: dict[str, Any]) -> str:
    """A cell as Markdown."""
    source = "".join(cell["source"])
    if cell["cell_type"] != "code":
        return source
    return "\n\n".join([f"```python\n{source}\n```", *map(_output, cell["outputs"])])


def _output(output: dict[str, Any]) -> str:
    """An output as Markdown: the richest of its forms."""
    data = output.get("data", {})
    if "text/html" in data:
        return f'<div class="output">{"".join(data["text/html"])}</div>'
    if "image/png" in data:
        picture = "".join(data["image/png"]).strip()
        return f'<img alt="Output of the cell above" src="data:image/png;base64,{picture}">'
    text = "".join(output.get("text") or data.get("text/plain", ""))
    return f"```text\n{text.rstrip()}\n```"
