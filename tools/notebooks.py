"""Runs notebooks and writes what their cells print and draw into them, or into copies elsewhere.

python tools/notebooks.py                                            # all of docs/notebooks
python tools/notebooks.py docs/notebooks/policy.ipynb --out FOLDER   # one, into a copy

The cells run here, in order, without Jupyter. They are plain Python: what they print, and each
figure that `pyplot.show` would open, is kept.
"""

import argparse
import base64
import io
import json
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
DPI = 90  # of pictures, 9 inches wide: as wide as a page of the site, and small files


def outputs_of(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Runs a cell among the names of those before it.

    Returns its outputs as a notebook holds them.
    """
    outputs: list[dict[str, Any]] = []
    printed = io.StringIO()

    def keep_text() -> None:
        if text := printed.getvalue():
            outputs.append(
                {"name": "stdout", "output_type": "stream", "text": text.splitlines(keepends=True)}
            )
        printed.seek(0)
        printed.truncate()

    def keep_figures() -> None:
        keep_text()
        for number in plt.get_fignums():
            figure, file = plt.figure(number), io.BytesIO()
            figure.savefig(file, dpi=DPI, metadata={"Software": None})
            data = {
                "image/png": base64.b64encode(file.getvalue()).decode(),
                "text/plain": [str(figure)],
            }
            outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
        plt.close("all")

    plt.show = keep_figures
    with redirect_stdout(printed):
        exec(compile(source, "<cell>", "exec"), names)  # noqa: S102 - a notebook of this repository
    keep_text()
    return outputs


def run(notebook: dict[str, Any]) -> None:
    """Runs all cells and keeps their outputs in the place of older ones."""
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = (cell for cell in notebook["cells"] if cell["cell_type"] == "code")
    for count, cell in enumerate(cells, start=1):
        cell["outputs"] = outputs_of("".join(cell["source"]), names)
        cell["execution_count"] = count


def main() -> None:
    """Runs what the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(FOLDER.glob("*.ipynb")))
    parser.add_argument(
        "--out", type=Path, help="folder for the notebooks as run; by default each is replaced"
    )
    arguments = parser.parse_args()
    places = {
        path.resolve(): (arguments.out or path.parent).resolve() / path.name
        for path in arguments.notebooks
    }
    for path, place in places.items():  # in full: cells may change the folder
        notebook = json.loads(path.read_text(encoding="utf-8"))
        run(notebook)
        place.write_text(
            json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    sys.exit(main())
