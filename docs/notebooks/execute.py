"""Runs the notebooks and keeps what they print and draw in them.

python docs/notebooks/execute.py [impact own_robot]
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parent


def main(names: list[str]) -> None:
    """Executes the notebooks of those names, all without any."""
    for name in names or sorted(file.stem for file in FOLDER.glob("*.ipynb")):
        file = FOLDER / f"{name}.ipynb"
        notebook = nbformat.read(file, as_version=4)
        NotebookClient(
            notebook,
            timeout=600,
            resources={"metadata": {"path": str(FOLDER)}},
            coalesce_streams=True,
            record_timing=False,
        ).execute()
        notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
        nbformat.write(notebook, file)
        print(f"{file.name}: {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
