"""The pages of the website: where each of them goes, what their links lead to there, and the navigation."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

TOP = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "docs/README.md": "contents.md",
    "docs/post-analysis.ipynb": "post-analysis-notebook.md",
}
"""Where pages go that are not simply moved from docs/ to the top."""
FENCED = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
TITLED = re.compile(r'^```(\w+) title="([^"\n]+)"$', re.MULTILINE)
ENTRY = re.compile(r"\[([^\]]+)\]\(([^)]+)\)")


def toctree(entries: list[str], *, caption: str = "", hidden: bool = True) -> str:
    """Return a directive with documents of the website, ``name`` or ``title <name>``."""
    options = [":hidden:"] if hidden else []
    options += [f":caption: {caption}"] if caption else []
    return "\n".join(["", "```{toctree}", *options, "", *entries, "```", ""])


@dataclass
class Site:
    """The folder that Sphinx reads, made from the repository at ``root``."""

    root: Path
    source: Path

    def add(self, page: Path, name: str) -> None:
        """Copy a page of the repository to the name that it has in the website."""
        self.write(name, page.read_text(encoding="utf-8"), page)

    def write(self, name: str, text: str, page: Path) -> None:
        """Write a page; its links are taken to be relative to ``page`` of the repository."""
        parts, end = [], 0
        for block in FENCED.finditer(text):
            parts += [self._linked(text[end : block.start()], page), self._fenced(block.group())]
            end = block.end()
        parts.append(self._linked(text[end:], page))
        (self.source / name).write_text("".join(parts), encoding="utf-8")

    def append(self, name: str, text: str) -> None:
        """Add to the end of a page what is made for the website alone."""
        with (self.source / name).open("a", encoding="utf-8") as file:
            file.write("\n" + text)

    def _fenced(self, block: str) -> str:
        """Return a block with the name of the file, if it is one, above it."""
        shown = TITLED.sub(r"```{code-block} \1\n:caption: \2\n", block)
        return re.sub(r"^```(\{code-block\} )?csv$", r"```{code-block} text", shown, flags=re.MULTILINE)

    def _linked(self, text: str, page: Path) -> str:
        return LINK.sub(lambda found: self._link(found[1], found[2], found[3] or "", page), text)

    def _link(self, text: str, link: str, anchor: str, page: Path) -> str:
        """Return a link; where its text is the name of the page, the website shows the title instead."""
        target = self._target(link, page)
        return f"[{'' if text == link and target.endswith('.md') else text}]({target}{anchor})"

    def _target(self, link: str, page: Path) -> str:
        """Return where a link of a page leads to in the website; raises FileNotFoundError."""
        if "://" in link or (self.source / link).is_file():  # the second: what was made for the website
            return link
        path = (page.parent / link).resolve(strict=True).relative_to(self.root)
        if path.as_posix() in TOP:
            return TOP[path.as_posix()]
        if path.parts[0] == "docs" and (path.suffix == ".md" or path.parts[1] == "pictures"):
            return PurePosixPath(*path.parts[1:]).as_posix()
        copied = self.source / "code" / f"{path.as_posix()}.txt"  # a browser shows it, instead of storing it
        copied.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(self.root / path, copied)
        return copied.relative_to(self.source).as_posix()

    def navigation(self, contents: str) -> str:
        """Return the navigation: a part for every section of the page of contents, with the links of that section."""
        text = (self.source / contents).read_text(encoding="utf-8")
        made = toctree([f"Contents <{contents.removesuffix('.md')}>"])
        for section in text.split("\n## ")[1:]:
            caption, _, rest = section.partition("\n")
            entries = []
            for title, target in ENTRY.findall(rest):
                entry = f"{title} <{target.removesuffix('.md')}>"
                if "#" not in target and entry not in entries:
                    entries.append(entry)
            made += toctree(entries, caption=caption)
        return made
