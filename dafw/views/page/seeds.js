// Every seed of a study as a point at its ERR; a point leads to the page of its run where there is one.

import { element } from "./dom.js";
import { formatNumber, powerTicks, tickLabel } from "./format.js";

const SPACE = "http://www.w3.org/2000/svg";
const HEIGHT = 46;
const MARGIN = 14;

/** Draws a strip for each configuration, all with one logarithmic scale. */
export class Seeds {
  constructor({ groups, success }) {
    Object.assign(this, { groups, success });
    this.room = document.querySelector("#seeds .strips");
    const known = groups.flatMap(({ points }) => points).map(({ err }) => err).filter((err) => err > 0);
    const ends = known.length ? [Math.min(...known), Math.max(...known)] : [1, 100];
    this.low = Math.min(ends[0], success) / 1.3;
    this.high = Math.max(ends[1], success, 100) * 1.3;
    const pages = groups.some(({ points }) => points.some(({ page }) => page));
    const hint = [
      `Blue: below ${formatNumber(success)} %, a success. Orange: above. A cross at the right: a run that failed.`,
      pages ? "A point leads to the page of its run." : "dafw report FOLDER --runs makes the pages of all runs, too.",
    ];
    document.querySelector("#seeds .hint").textContent = hint.join(" ");
    document.getElementById("seeds").hidden = false;
    new ResizeObserver(() => this.draw()).observe(this.room);
    this.draw();
  }

  draw() {
    this.width = this.room.clientWidth;
    if (!this.width) return;
    const last = this.groups.length - 1;
    this.room.replaceChildren(...this.groups.map((group, k) => this.strip(group, k === last)));
  }

  toX(err) {
    const share = Math.log(err / this.low) / Math.log(this.high / this.low);
    return MARGIN + Math.min(1, Math.max(0, share)) * (this.width - 3 * MARGIN);
  }

  strip({ name, points }, labelled) {
    const height = HEIGHT + (labelled ? 18 : 0);
    const label = { role: "group", "aria-label": `Seeds of ${name}` };
    const svg = shape("svg", { viewBox: `0 0 ${this.width} ${height}`, height, ...label });
    for (const tick of ticks(this.low, this.high)) {
      const x = this.toX(tick);
      svg.append(shape("line", { x1: x, x2: x, y1: 0, y2: HEIGHT, style: { stroke: "var(--grid)" } }));
      if (labelled) svg.append(shape("text", { x, y: HEIGHT + 14, "text-anchor": "middle" }, `${tickLabel(tick)} %`));
    }
    const limit = this.toX(this.success);
    const dashed = { stroke: "var(--soft)", strokeDasharray: "3 3" };
    svg.append(shape("line", { x1: limit, x2: limit, y1: 0, y2: HEIGHT, style: dashed }));
    points.forEach((point, k) => svg.append(this.point(point, name, k)));
    return element("figure", { class: "strip" }, [element("figcaption", {}, [name]), svg]);
  }

  point({ seed, err, status, page }, name, k) {
    const ended = status === "complete" && err !== null;
    const text = `${name}, seed ${seed}: ${ended ? `ERR ${formatNumber(err)} %` : "failed"}`;
    // Points side by side must not hide each other: every one has its height, by the golden section.
    const y = 7 + ((k * 0.618034) % 1) * (HEIGHT - 14);
    const x = ended ? this.toX(Math.max(err, this.low)) : this.width - MARGIN;
    const colour = ended && err < this.success ? "var(--belief)" : "var(--revised)";
    const mark = ended
      ? shape("circle", { cx: x, cy: y, r: 5, style: { fill: colour, stroke: "var(--page)", fillOpacity: "0.85" } })
      : shape("path", { d: `M${x - 4} ${y - 4}l8 8m0-8l-8 8`, style: { stroke: colour, strokeWidth: "2" } });
    mark.append(shape("title", {}, text));
    if (!page) return mark;
    const link = shape("a", { href: page, "aria-label": `${text}; opens its page` });
    link.append(mark);
    return link;
  }
}

function ticks(low, high) {
  const powers = powerTicks(low, high, 8);
  if (powers.length > 2) return powers;
  const finer = [powers[0] / 10, ...powers].flatMap((power) => [power, 2 * power, 5 * power]);
  return finer.filter((tick) => tick > low && tick < high);
}

function shape(name, { style = {}, ...attributes }, text = "") {
  const made = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  Object.assign(made.style, style);
  if (text) made.textContent = text;
  return made;
}
