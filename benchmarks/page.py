"""How large the page of a run is, how soon it opens, and how smoothly it plays, in a real browser.

``python -m benchmarks.page FOLDER [--picture FILE]`` prints a table. The browser is Chromium without graphics hardware:
``chromium`` on ``PATH``, or what DAFW_BROWSER names. "open" is the median time from the request to the first drawing.
While every frame shows another time, "draw" is what the page's own scripts take for a frame, and "frame" the time from
one frame to the next (``requestAnimationFrame``), in which the browser puts the picture together by software, too; both
as median and 95 %. ``--picture`` writes a picture of the page at 40 % of the run.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median, quantiles
from time import process_time
from typing import Any

from dafw.views.report import write_report

VIEWS = {
    "desktop": {"viewport": {"width": 1280, "height": 900}},
    "phone": {"viewport": {"width": 390, "height": 844}, "device_scale_factor": 2},
}
PLAY = """async (frames) => {
    const { player } = window.dafw;
    const [costs, times] = [[], []];
    for (let k = 0; k < frames; k += 1) {
        times.push(await new Promise(requestAnimationFrame));
        player.row = k % player.count;
        const begun = performance.now();
        player.draw();
        costs.push(performance.now() - begun);
    }
    return { costs, intervals: times.slice(1).map((time, k) => time - times[k]) };
}"""


@dataclass(frozen=True)
class Measured:
    """A page in one window: milliseconds until it is drawn; of each frame, those of the scripts and since the last."""

    open: float
    draws: Sequence[float]
    intervals: Sequence[float]

    @property
    def draw(self) -> float:
        """The median of the scripts' milliseconds for a frame."""
        return median(self.draws)


def measured(browser: Any, file: Path, view: str, loads: int = 5, frames: int = 300) -> Measured:
    """Open the page several times, then show other times in as many frames."""
    opened, found = [], {}
    for load in range(loads):
        tab = browser.new_page(**VIEWS[view])
        tab.goto(file.resolve().as_uri())
        tab.wait_for_selector("html[data-ready]")
        opened.append(tab.evaluate("() => performance.now()"))
        if load == loads - 1:
            found = tab.evaluate(PLAY, frames)
        tab.close()
    return Measured(median(opened), found["costs"], found["intervals"])


def told(milliseconds: Sequence[float]) -> str:
    """Return median and 95 % as a cell of the table."""
    return f"{median(milliseconds):.1f}, {quantiles(milliseconds, n=20)[-1]:.1f} ms"


def picture(browser: Any, file: Path, to: Path) -> None:
    """Write a picture of what a desktop shows when the page is opened and 40 % of the run are over."""
    tab = browser.new_page(**VIEWS["desktop"])
    tab.goto(file.resolve().as_uri())
    tab.wait_for_selector("html[data-ready]")
    tab.evaluate(
        "() => { const { player } = window.dafw; player.row = Math.round(0.4 * (player.count - 1)); player.draw(); }"
    )
    box = tab.locator(".map .layers").first.bounding_box()
    if box is not None:
        tab.mouse.click(box["x"] + 0.42 * box["width"], box["y"] + 0.4 * box["height"])
    tab.wait_for_timeout(300)
    tab.screenshot(path=to)
    tab.close()


def main(words: Sequence[str] | None = None) -> int:
    """Measure, print the table, and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.page", description="The page of a run in a browser.")
    parser.add_argument("run", type=Path, help="the folder of a run")
    parser.add_argument("--picture", type=Path, help="write a picture of the page to this PNG")
    asked = parser.parse_args(words)
    path = os.environ.get("DAFW_BROWSER") or shutil.which("chromium")
    if path is None:
        parser.error("there is no chromium on PATH; DAFW_BROWSER can name a browser")
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        begun = process_time()
        file = write_report(asked.run, Path(folder, "report.html"))
        print(f"{file.stat().st_size / 1e6:.2f} MB, written in {process_time() - begun:.1f} s of processor time\n")
        browser = playwright.chromium.launch(executable_path=path)
        print("| window | open | draw: median, 95 % | frame: median, 95 % |\n|---|---|---|---|")
        for view in VIEWS:
            one = measured(browser, file, view)
            print(f"| {view} | {one.open:.0f} ms | {told(one.draws)} | {told(one.intervals)} |", flush=True)
        if asked.picture is not None:
            picture(browser, file, asked.picture)
        browser.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
