"""What a page for people says, in a line: Overpass servers, and whatever stands before them, send errors as HTML."""

from __future__ import annotations

import re
from html import unescape

LONGEST = 160
"""Characters of a line."""


def words_of_page(content: bytes) -> str:
    """Return the text of a page as one line without markup, from the first error in it if it names one."""
    text = content.decode("utf-8", errors="replace")
    text = re.sub(r"(?is)<(script|style|head)\b.*?</\1\s*>|<!--.*?-->", " ", text)
    text = unescape(re.sub(r"<[^>]*>", " ", text))
    line = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
    if named := re.search(r"\bError ?: (.+)", line):
        line = named[1]
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."
