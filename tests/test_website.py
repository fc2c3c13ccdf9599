"""The documentation as a website, built once, without a warning, and without a network; the notebook; the gallery."""

from __future__ import annotations

import html
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock
from fresh import ROOT
from waiting import PATIENCE

import dafw
import dafw.testing
from dafw.core.registry import registry

WEBSITE = ROOT / "docs" / "website"
NOTEBOOK = ROOT / "docs" / "post-analysis.ipynb"


@pytest.fixture(autouse=True)
def _modules_of_the_website(monkeypatch):
    monkeypatch.syspath_prepend(WEBSITE)


@pytest.fixture(scope="session")
def website(tmp_path_factory):
    """Return the folder of the built website: one for all processes of the tests."""
    folder = tmp_path_factory.getbasetemp()
    folder = (folder.parent if folder.name.startswith("popen-") else folder) / "website"
    with FileLock(f"{folder}.lock"):
        if not folder.exists():
            command = [sys.executable, WEBSITE / "build.py", folder]
            elsewhere = tmp_path_factory.mktemp("empty")
            done = subprocess.run(command, cwd=elsewhere, capture_output=True, timeout=2 * PATIENCE)
            (folder / "said").write_bytes(b"%d\n" % done.returncode + done.stdout + done.stderr)
    return folder


def words(page: Path) -> str:
    """Return the text of a page of the website."""
    return html.unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


def test_the_website_is_built_without_a_warning(website):
    assert (website / "said").read_text() == "0\n"


def test_every_page_is_there_and_in_the_navigation(website):
    names = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    names |= {"contents", "contributing", "changelog", "post-analysis-notebook", "plugins-filter"}
    navigation = (website / "html" / "index.html").read_text(encoding="utf-8")
    for name in names:
        assert (website / "html" / f"{name}.html").is_file(), name
        assert f'href="{name}.html"' in navigation or name.startswith("plugins-"), name


def test_nothing_is_loaded_from_elsewhere(website):
    for page in (website / "html").rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]+src=\"([^\"]+)\"", text)
        loaded += re.findall(r"<link[^>]+href=\"([^\"]+)\"", text)
        assert loaded and not [address for address in loaded if address.startswith(("http", "//"))], page
    for style in (website / "html" / "_static").rglob("*.css"):
        assert not re.search(r"url\([\"']?(https?:)?//|@import", style.read_text(encoding="utf-8")), style


def test_the_reference_has_every_option_of_every_plugin(website):
    for plugin in registry().plugins():
        if not plugin.spec.target.startswith("dafw."):
            continue
        page = words(website / "html" / f"plugins-{plugin.spec.kind}.html")
        assert plugin.spec.summary[1:] in page
        for option in registry().options(plugin.spec.kind, plugin.spec.name):
            assert option.name in page and option.accepted in page and " ".join(option.help.split()) in page, option


def test_the_reference_has_every_public_name(website):
    page = (website / "html" / "python-reference.html").read_text(encoding="utf-8")
    found = set(re.findall(r'id="dafw\.(?:[\w.]+\.)?(\w+)"', page))
    assert set(dafw.__all__) | set(dafw.testing.__all__) | {"RunAccessor"} <= found


@pytest.mark.parametrize("width", [1280, 390])
def test_the_first_screen(website, browser, width):
    context = browser.new_context(viewport={"width": width, "height": 900})
    tab, complaints, requests = context.new_page(), [], []
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto((website / "html" / "index.html").as_uri())
    picture = tab.locator("article img").first
    assert "recommended" in picture.get_attribute("src")
    for seen in (picture, tab.locator("article pre").first):  # what it looks like, and how to start
        box = seen.bounding_box()
        assert box["y"] + box["height"] < 900 and box["x"] + box["width"] <= width
    assert tab.locator("article pre").first.inner_text().startswith("sh setup.sh dafw run")
    for page in ("tutorial", "theory", "plugins-model", "plugins-filter", "python-reference"):
        tab.goto((website / "html" / f"{page}.html").as_uri())
        assert tab.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), page
    assert complaints == [] and all(address.startswith(("file:", "data:")) for address in requests)
    context.close()


@pytest.mark.filterwarnings("ignore:path is deprecated:DeprecationWarning")  # of importlib.resources in 3.12 alone
def test_formulas_are_drawn_or_refused():
    from formulas import drawn

    picture = drawn(r"\frac{\partial c}{\partial t} < 0", inline=False)
    assert picture.startswith("<svg ") and 'aria-label="\\frac{\\partial c}{\\partial t} &lt; 0"' in picture
    assert "vertical-align" in drawn("x_i", inline=True)
    with pytest.raises(ValueError, match=r"not known: \\unheardof"):
        drawn(r"\unheardof", inline=True)
    with pytest.raises(ValueError, match=r"cannot be read .*: \\frac\{1"):
        drawn(r"\frac{1", inline=True)


@pytest.mark.parametrize(
    ("link", "leads_to"),
    [
        ("physics.md", "physics.md"),
        ("physics.md#wind", "physics.md#wind"),
        ("../README.md", "index.md"),
        ("../CONTRIBUTING.md", "contributing.md"),
        ("post-analysis.ipynb", "post-analysis-notebook.md"),
        ("pictures/report.png", "pictures/report.png"),
        ("../dafw/core/space.py", "code/dafw/core/space.py.txt"),
        ("https://doi.org/10.1002/qj.2236", "https://doi.org/10.1002/qj.2236"),
    ],
)
def test_links_lead_to_the_same_in_the_website(link, leads_to, tmp_path):
    from pages import Site

    site = Site(ROOT, tmp_path)
    block = f"\n\n```sh\n[a]({link})\n```\n"
    site.write("page.md", f"[a]({link}) [{link}]({link}){block}", ROOT / "docs" / "page.md")
    named = "" if leads_to.endswith(".md") else link  # of a page, the title
    assert (tmp_path / "page.md").read_text() == f"[a]({leads_to}) [{named}]({leads_to}){block}"


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path):
    from build import build

    (tmp_path / "source").mkdir()
    with pytest.raises(FileExistsError, match="neither empty nor a website"):
        build(tmp_path)
    assert (tmp_path / "source").is_dir()


def test_a_link_to_nothing_is_an_error(tmp_path):
    from pages import Site

    with pytest.raises(FileNotFoundError, match=r"nothing\.md"):
        Site(ROOT, tmp_path).write("page.md", "[a](nothing.md)", ROOT / "docs" / "page.md")


def test_the_notebook_runs_and_shows_what_it_has_shown(tmp_path, monkeypatch):
    """Eight cycles instead of 36, so the numbers differ; the last picture but one needs the same mesh and belief."""
    from notebook import executed

    monkeypatch.chdir(tmp_path)
    stored = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    text = NOTEBOOK.read_text(encoding="utf-8")
    assert text.count("cycles=36") == 1
    done = executed(json.loads(text.replace("cycles=36", "cycles=8")))
    for old, new in zip(stored["cells"], done["cells"], strict=True):
        assert shown(old) == shown(new)


def shown(cell: dict) -> list[str]:
    """Return the outputs of a cell: their text without numbers, or the kind of a picture."""
    return [
        re.sub(r"[\d.]+", "#", "".join(output["text"])) if "text" in output else " ".join(output["data"])
        for output in cell.get("outputs", [])
    ]


def test_pictures_of_the_gallery_have_commands_that_are_tried():
    """On the gallery's page commands stand in sentences; each must stand in a block of another page, which is run."""
    from test_docs import PAGES, blocks, commands

    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    tried = {" ".join(one.split()) for page in PAGES for block in blocks(page) for one in commands(block)}
    pictures = {path.name for path in (ROOT / "docs" / "pictures").iterdir()}
    assert set(re.findall(r"\]\(pictures/([^)]+)\)", gallery)) == pictures
    for section in gallery.split("\n## ")[1:]:
        named = re.findall(r"`((?:dafw|python -m) [^`]+)`", section)
        assert named
        for command in named:
            assert any(one.startswith(command) for one in tried), command
