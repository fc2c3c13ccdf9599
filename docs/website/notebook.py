"""The notebook docs/post-analysis.ipynb: run its cells and keep what they print and draw; or show it as a page.

    python docs/website/notebook.py    run the notebook, and write it anew with its outputs

The cells are plain Python, so no kernel is needed: that would be 37 packages for one notebook.
"""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from pathlib import Path
from typing import Any

NOTEBOOK = Path(__file__).resolve().parents[1] / "post-analysis.ipynb"


def executed(notebook: dict[str, Any]) -> dict[str, Any]:
    """Return a notebook with the outputs of its cells, run in the present folder; raises what a cell raises."""
    from matplotlib import pyplot

    pyplot.close("all")
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = []
    for number, cell in enumerate(notebook["cells"]):
        if cell["cell_type"] == "code":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                run_cell("".join(cell["source"]), f"cell {number}", names)
            outputs = []
            if text := printed.getvalue():
                outputs.append({"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)})
            for figure in map(pyplot.figure, pyplot.get_fignums()):
                picture = io.BytesIO()
                figure.savefig(picture, format="png", dpi=80, metadata={"Software": None})
                data = {"image/png": base64.b64encode(picture.getvalue()).decode()}
                outputs.append({"output_type": "display_data", "metadata": {}, "data": data})
            pyplot.close("all")
            cell = cell | {"outputs": outputs, "execution_count": None}
        cells.append(cell)
    return notebook | {"cells": cells}


def run_cell(source: str, place: str, names: dict[str, Any]) -> None:
    """Run a cell; like Jupyter, print the value of an expression on its last line, unless it ends with a semicolon."""
    tree = ast.parse(source, place)
    shown = tree.body and isinstance(tree.body[-1], ast.Expr) and not source.endswith(";")
    last = tree.body.pop() if shown else None
    exec(compile(tree, place, "exec"), names)
    if isinstance(last, ast.Expr):
        value = eval(compile(ast.Expression(last.value), place, "eval"), names)
        if value is not None:
            print(value)


def as_markdown(path: Path, pictures: Path) -> str:
    """Return a notebook with its outputs as a page in Markdown, whose pictures are written into a folder."""
    parts = []
    for number, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            if output["output_type"] == "stream":
                parts.append(f"```text\n{''.join(output['text']).rstrip()}\n```")
            else:
                name = f"{path.stem}-{number}.png"
                (pictures / name).write_bytes(base64.b64decode(output["data"]["image/png"]))
                parts.append(f"![what the cell above draws](pictures/{name})")
    return "\n\n".join(parts) + "\n"


def main() -> None:
    """Run the notebook in an empty folder, and write it anew."""
    import matplotlib

    matplotlib.use("Agg")
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        done = executed(notebook)
        os.chdir(NOTEBOOK.parent)
    NOTEBOOK.write_text(json.dumps(done, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
