"""How large the page of a run is, how soon it opens, and how smoothly it plays, in a real browser.

``python -m benchmarks.page FOLDER [--picture FILE]`` prints a table. The browser is Chromium without graphics hardware:
``chromium`` on ``PATH``, or what DAFW_BROWSER names. "open" is the median time from the request to the first drawing.
While every frame shows another time, "draw" is what the page's own scripts take for a frame, and "frame" the time from
one frame to the next (``requestAnimationFrame``), in which the browser puts the picture together by software, too; both
as median and 95 %. "processor" is the mean time that a frame keeps a processor busy in the page's main thread, which
waits for nobody: scripts, style, layout, painting, handing over. Unlike the others it hardly depends on what else the
machine does. ``--picture`` writes a picture of the page at 40 % of the run.
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
    player.playing = true;
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
    """A page in one window, in milliseconds: until it is drawn; of each frame, those of the scripts and since the last;
    of a frame on average, those of a processor in the main thread.
    """

    open: float
    draws: Sequence[float]
    intervals: Sequence[float]
    processor: float

    @property
    def draw(self) -> float:
        """The median of the scripts' milliseconds for a frame."""
        return median(self.draws)


def measured(browser: Any, file: Path, view: str, loads: int = 5, frames: int = 300) -> Measured:
    """Open the page several times, then show other times in as many frames."""
    opened, found, spent = [], {}, 0.0
    for load in range(loads):
        tab = browser.new_page(**VIEWS[view])
        tab.goto(file.resolve().as_uri())
        tab.wait_for_selector("html[data-ready]")
        opened.append(tab.evaluate("() => performance.now()"))
        if load == loads - 1:
            session = tab.context.new_cdp_session(tab)
            session.send("Performance.enable", {"timeDomain": "threadTicks"})
            begun = _busy(session)
            found = tab.evaluate(PLAY, frames)
            spent = 1000.0 * (_busy(session) - begun) / frames
        tab.close()
    return Measured(median(opened), found["costs"], found["intervals"], spent)


def _busy(session: Any) -> float:
    """Return the seconds for which the main thread of a page has kept a processor busy."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(one["value"] for one in metrics if one["name"] == "TaskDuration"))


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
        print("| window | open | draw: median, 95 % | frame: median, 95 % | processor |\n|---|---|---|---|---|")
        for view in VIEWS:
            one = measured(browser, file, view)
            cells = [f"{one.open:.0f} ms", told(one.draws), told(one.intervals), f"{one.processor:.1f} ms"]
            print(f"| {' | '.join([view, *cells])} |", flush=True)
        if asked.picture is not None:
            picture(browser, file, asked.picture)
        browser.close()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
