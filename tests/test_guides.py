"""The guides, tried literally: their files written, their commands run as printed, what they say comes out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fresh import ROOT, environment

from dafw.testing import CHECKS

DOCS = ROOT / "docs"
GUIDES = ("write-a-filter.md", "write-a-model.md", "write-a-policy.md", "write-a-smoother.md")
BLOCK = re.compile(r'^```(\w+)(?: title="([^"\n]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)


def script(guide: Path) -> tuple[str, list[str]]:
    """Return the guide's files and commands as a shell script, and the lines that its commands must print."""
    steps, printed = [], []
    for language, title, content in BLOCK.findall(guide.read_text()):
        if language == "sh":
            steps.append(content)
        elif title:
            steps.append(f"cat >{title} <<'END OF FILE'\n{content}END OF FILE\n")
        elif language == "text":
            printed += [line for line in content.splitlines() if not line.startswith("dafw run ")]
    return "".join(steps), printed


@pytest.mark.parametrize("name", GUIDES)
def test_a_guide_does_what_it_says(name, tmp_path):
    commands, printed = script(DOCS / name)
    done = environment().run("sh", "-e", "-c", commands, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    shown = [" ".join(line.split()) for line in done.stdout.splitlines()]
    assert [line for line in printed if line not in shown] == []


def test_links_between_the_pages_lead_somewhere():
    for page in (*GUIDES, "plugins.md", "conformance.md"):
        for target in re.findall(r"\]\(([^)#]+)\)", (DOCS / page).read_text()):
            assert (DOCS / target).exists(), f"{page}: {target}"


def test_the_page_on_conformance_has_every_check_with_its_reason():
    page = (DOCS / "conformance.md").read_text()
    sections = re.findall(r"^### (\w+): (\w+)\n\n(.+)$", page, re.MULTILINE)
    expected = [(kind, name, check.reason) for kind, checks in CHECKS.items() for name, check in checks.items()]
    assert sections == expected
