"""A page in a real browser that may ask nothing of any network, and what the browser says of it."""

from __future__ import annotations

import base64
import io
import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.image import imread

PATIENCE = 60_000.0
"""Milliseconds after which a page that does not answer has failed."""
NAMES = ("chromium", "chromium-browser", "google-chrome")


def installed_browser() -> str | None:
    """Return the path of a Chromium, that of the variable DAFW_BROWSER first; None if there is none."""
    return os.environ.get("DAFW_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)


@dataclass
class Opened:
    """A page, the requests that it made, and whatever errors and messages the browser reported."""

    tab: object
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def find(self, selector):
        return self.tab.locator(selector)

    def text(self, selector):
        return self.find(selector).inner_text()

    def go(self, row):
        """Show a row by the slider, as somebody who drags it does, and wait until it is drawn."""
        self.find("#slider").fill(str(row))
        self.drawn()

    def drawn(self):
        """Wait for two frames: one draws what was asked for, with the other it is done."""
        self.tab.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def pixels(self, selector):
        """Return the pixels (height, width, 4) of a canvas, between 0 and 1."""
        address = self.find(selector).evaluate("(canvas) => canvas.toDataURL()")
        return imread(io.BytesIO(base64.b64decode(address.split(",")[1])))

    def overflow(self):
        """Return by how many pixels the page is wider than the screen."""
        return self.tab.evaluate("() => document.documentElement.scrollWidth - innerWidth")


def open_page(browser, place: Path | str, **options) -> Opened:
    """Open a file, or an address, in a browser context of its own; requests that begin otherwise are refused."""
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
    context.set_default_timeout(PATIENCE)
    address = place if isinstance(place, str) else place.resolve().as_uri()
    context.route("**/*", lambda route: route.continue_() if route.request.url.startswith(address) else route.abort())
    opened = Opened(context.new_page())
    opened.tab.on("request", lambda request: opened.requests.append(request.url))
    opened.tab.on("console", lambda message: opened.complaints.append(f"{message.type}: {message.text}"))
    opened.tab.on("pageerror", lambda error: opened.complaints.append(f"error: {error}"))
    opened.tab.on("dialog", lambda dialog: opened.complaints.append("a dialog") or dialog.dismiss())
    opened.tab.goto(address)
    opened.tab.wait_for_selector("html[data-ready]")
    opened.drawn()
    return opened


def number(text: str) -> float:
    """Return the number at the beginning of a text as the page writes it."""
    word = text.split("\u202f")[0].split("°")[0].replace("−", "-")
    if "×10" in word:
        front, power = word.split("×10")
        return float(front) * 10.0 ** int(power.translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")))
    return float(word)


def differ(one: np.ndarray, other: np.ndarray) -> float:
    """Return the share of the pixels in which two pictures of the same size differ."""
    return float(np.any(np.abs(one - other) > 0.02, axis=-1).mean())
