// A state without places in the plane: its values over the index, at the time that is shown.

import { Axes, verticalRange } from "./axes.js";
import { recordedRow } from "./data.js";
import { chartFrame, drawWhole, element, heading } from "./dom.js";
import { STAGES, dashes, style } from "./theme.js";

/** Draws truth, belief with its band and free run over the index; `fields` are the decoded ones. */
export class Profile {
  constructor(data, fields, theme, player) {
    Object.assign(this, { data, theme, player });
    this.fields = Object.fromEntries(fields.map((field) => [field.key, field]));
    this.keys = Object.keys(STAGES).filter((key) => this.fields[key]);
    this.nodes = fields[0].nodes;
    this.index = Array.from({ length: this.nodes }, (_, k) => k);
    this.marks = this.keys.map((key) => element("i", { class: style(key) }));
    const room = document.querySelector("#profile .charts");
    const title = heading(`${data.variable.title} over its index`, data.variable.units);
    Object.assign(this, chartFrame(room, "profile", [title]));
    this.figure.classList.add("wide");
    this.legend.append(...this.keys.map((key, k) => element("li", {}, [this.marks[k], STAGES[key]])));
    document.getElementById("profile").hidden = false;
    this.refresh(fields);
    drawWhole(this, theme, player);
  }

  /** Show new values of the same run. */
  refresh(fields) {
    for (const field of fields) Object.assign(this.fields[field.key], field);
    const everything = this.keys.map((key) => ({ values: Array.from(this.fields[key].values) }));
    this.range = verticalRange({ lines: everything }, false);
  }

  draw() {
    if (!this.size) return;
    const { context, width, height } = this.size;
    context.clearRect(0, 0, width, height);
    const axes = new Axes(context, width, height, [0, Math.max(1, this.nodes - 1)], this.range, false);
    axes.drawGrid(this.theme.colours, "index");
    const { rows } = this.data.fields;
    const at = recordedRow(rows, this.player.row);
    const part = (key) => Array.from(this.fields[key].values.subarray(at * this.nodes, (at + 1) * this.nodes));
    axes.clipped(() => {
      if (this.fields.spread && this.fields.mean && !this.data.fields.logarithm) {
        const [mean, spread] = [part("mean"), part("spread")];
        const bound = (sign) => mean.map((value, k) => value + sign * spread[k]);
        axes.drawBand(this.index, bound(-1), bound(1), this.theme.line("mean"));
      }
      for (const key of [...this.keys].reverse()) {
        axes.drawLine(this.index, part(key), this.theme.line(key), { dash: dashes(key) });
      }
    });
    this.keys.forEach((key, k) => {
      this.marks[k].style.color = this.theme.line(key);
    });
    const time = this.data.time;
    if (this.player.playing) return;
    const label = `${this.data.variable.title} over its index at t = ${time.values[rows[at]]} ${time.units}`;
    this.canvas.setAttribute("aria-label", label);
  }
}
