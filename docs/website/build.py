"""Builds the documentation as a website, which needs neither a server nor a network.

    python docs/website/build.py FOLDER

The pages are README, CONTRIBUTING, CHANGELOG and those of docs/, as they can be read on a code host. They are copied
into ``FOLDER/source`` with their links changed to where things are in the website. What is made from the code and the
notebook is added there. Sphinx then writes ``FOLDER/html``; a warning gives an exit status that is not zero.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pages
from notebook import as_markdown
from plugin_reference import plugin_pages
from python_reference import python_names
from sphinx.cmd.build import build_main

ROOT = Path(__file__).resolve().parents[2]
MARK = ".website"
"""File in a folder that says that it may be emptied, because it was made here."""


def stage(source: Path) -> None:
    """Write into the empty folder ``source`` what Sphinx reads."""
    site = pages.Site(ROOT, source)
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        site.add(ROOT / name, pages.TOP[name])
    for page in sorted((ROOT / "docs").glob("*.md")):
        site.add(page, pages.TOP.get(f"docs/{page.name}", page.name))
    shutil.copytree(ROOT / "docs" / "pictures", source / "pictures")
    notebook = ROOT / "docs" / "post-analysis.ipynb"
    site.write("post-analysis-notebook.md", as_markdown(notebook, source / "pictures"), notebook)
    shutil.copy(notebook, source)
    site.append("post-analysis-notebook.md", "The notebook itself: [post-analysis.ipynb](post-analysis.ipynb).\n")
    kinds = plugin_pages()
    for kind, text in kinds.items():
        site.write(f"plugins-{kind}.md", text, ROOT / "docs" / "plugin-reference.md")
    site.append("plugin-reference.md", pages.toctree([f"plugins-{kind}" for kind in kinds], hidden=False))
    site.append("python-reference.md", python_names())
    site.append("index.md", site.navigation("contents.md"))


def build(folder: Path) -> int:
    """Build the website anew in a folder; return Sphinx's exit status.

    Raises FileExistsError if there is something else in the folder.
    """
    if folder.exists():
        if any(folder.iterdir()) and not (folder / MARK).exists():
            raise FileExistsError(f"{folder} is neither empty nor a website that was built here before")
        shutil.rmtree(folder)
    (folder / "source").mkdir(parents=True)
    (folder / MARK).touch()
    stage(folder / "source")
    options = ["--fail-on-warning", "--quiet", "--conf-dir", str(Path(__file__).parent)]
    folders = ["--doctree-dir", str(folder / "doctrees"), str(folder / "source"), str(folder / "html")]
    return build_main([*options, *folders])


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(f"usage: python {sys.argv[0]} FOLDER")
    try:
        sys.exit(build(Path(sys.argv[1]).resolve()))
    except (FileExistsError, NotADirectoryError) as error:
        sys.exit(f"{sys.argv[0]}: {error}")
