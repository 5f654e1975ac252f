"""The notebooks run, and print what is saved in them."""

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def texts(notebook):
    """What the cells of a notebook give: text, or the kind of what is shown."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", ()))
    for output in outputs:
        data = output.get("data", {})
        shown = next((kind for kind in ("text/html", "image/png") if kind in data), None)
        yield shown or output.get("text") or data["text/plain"]


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_notebooks_print_what_is_saved(file, check_printed):
    saved = nbformat.read(file, as_version=4)
    fresh = nbformat.read(file, as_version=4)
    folder = {"metadata": {"path": str(FOLDER)}}
    NotebookClient(fresh, timeout=600, resources=folder, coalesce_streams=True).execute()
    for printed, shown in zip(texts(fresh), texts(saved), strict=True):
        check_printed(printed, shown)


def test_notebooks_are_saved_with_their_outputs_and_small():
    assert len(NOTEBOOKS) == 2
    for file in NOTEBOOKS:
        assert file.stat().st_size < 300_000, file
        assert any(texts(nbformat.read(file, as_version=4))), file
