// A chart of curves over time, with a legend that tells the values at the time that is shown, and a line at that time.

import { Axes, verticalRange } from "./axes.js";
import { chartFrame, element, fitted, follow, heading } from "./dom.js";
import { tickLabel, withUnits } from "./format.js";
import { dashes, style } from "./theme.js";

/**
 * One chart. `spec` has title, units, lines [{role, label, values}], and may have bands [{low, high, label}], reference
 * {value, label}, floor, and a remark on what is shown. `time` is {values, units}.
 */
export class Chart {
  constructor(room, spec, time, player, theme) {
    Object.assign(this, { spec, time, player, theme });
    this.log = false;
    this.title = element("div", {});
    Object.assign(this, chartFrame(room, spec.id, [this.title, ...this.logButton()], false));
    this.cursor = element("div", { class: "cursor", "aria-hidden": "true" });
    this.plot.append(this.cursor);
    this.fillCaption();
    this.connectPointer();
    theme.onChange(() => this.draw());
    follow(this.plot, player, { resize: () => this.draw(), draw: (row) => this.show(row) });
  }

  logButton() {
    if (!this.spec.log) return [];
    const button = element("button", { type: "button", class: "log", "aria-pressed": "false" }, ["log"]);
    button.setAttribute("aria-label", `Logarithmic scale for ${this.spec.title}`);
    button.addEventListener("click", () => {
      this.log = !this.log;
      button.setAttribute("aria-pressed", String(this.log));
      this.draw();
    });
    return [button];
  }

  /** Show other curves in the same place. */
  replace(spec) {
    this.spec = spec;
    this.fillCaption();
    this.draw();
  }

  fillCaption() {
    const { title, units, remark, lines, bands = [], reference } = this.spec;
    this.title.replaceChildren(heading(title, [units, remark].filter(Boolean).join(", ")));
    this.entries = lines.map((line) => ({ line, mark: element("i", {}), value: element("b", {}) }));
    for (const { line, mark } of this.entries) mark.className = line.role === "dots" ? "dot" : style(line.role);
    const items = this.entries.map(({ line, mark, value }) => element("li", {}, [mark, line.label, " ", value]));
    // The first band is the innermost, and the strongest.
    this.bandMarks = bands.map((band, k) => {
      const mark = element("i", {});
      mark.style.borderTopWidth = "9px";
      mark.style.opacity = String(k === 0 ? 0.3 : 0.16);
      items.push(element("li", {}, [mark, band.label]));
      return mark;
    });
    if (reference) {
      this.referenceMark = element("i", { class: "dotted" });
      items.push(element("li", {}, [this.referenceMark, reference.label]));
    }
    this.legend.replaceChildren(...items);
  }

  /** Dragging over the chart moves the time. */
  connectPointer() {
    const move = (event) => {
      if (!this.axes) return;
      const wanted = this.axes.fromX(event.clientX - this.plot.getBoundingClientRect().left);
      this.player.go(nearest(this.time.values, wanted));
    };
    this.plot.addEventListener("pointerdown", (event) => {
      this.plot.setPointerCapture(event.pointerId);
      move(event);
    });
    this.plot.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) move(event);
    });
  }

  draw() {
    if (!this.plot.clientWidth) return;
    const { spec, theme, time } = this;
    const { context, width, height } = fitted(this.canvas, this.plot);
    context.clearRect(0, 0, width, height);
    const y = verticalRange(spec, this.log);
    this.axes = new Axes(context, width, height, [time.values[0], time.values[time.values.length - 1]], y, this.log);
    this.axes.drawGrid(theme.colours, time.units);
    this.axes.clipped(() => {
      if (spec.reference) this.drawReference();
      for (const band of spec.bands ?? []) this.axes.drawBand(time.values, band.low, band.high, theme.line("mean"));
      for (const line of [...spec.lines].reverse()) {
        const colour = theme.line(line.role);
        const how = { dash: dashes(line.role), joined: line.joined };
        if (line.role === "dots") this.axes.drawDots(time.values, line.values, colour);
        else this.axes.drawLine(time.values, line.values, colour, how);
      }
    });
    for (const { line, mark } of this.entries) mark.style.color = theme.line(line.role);
    for (const mark of this.bandMarks) mark.style.color = theme.line("mean");
    if (this.referenceMark) this.referenceMark.style.color = theme.colours.soft;
    this.cursor.style.height = `${this.axes.bottom}px`;
    this.show(this.player.row);
  }

  drawReference() {
    const { value } = this.spec.reference;
    if (this.log && !(value > 0)) return;
    const ends = [this.time.values[0], this.time.values[this.time.values.length - 1]];
    this.axes.drawLine(ends, [value, value], this.theme.colours.soft, { width: 1.2, dash: [2, 3] });
  }

  /** Move the line to a row and tell the values there. */
  show(row) {
    if (!this.axes) return;
    this.cursor.style.transform = `translateX(${this.axes.toX(this.time.values[row])}px)`;
    if (!this.player.telling) return;
    const told = this.entries.map(({ line, value }) => {
      const text = withUnits(bounded(line.values[row], this.spec.units), this.spec.units);
      value.textContent = text;
      return `${line.label} ${text}`;
    });
    if (this.player.playing) return; // a label that changes many times a second helps nobody
    const at = `t = ${tickLabel(this.time.values[row])} ${this.time.units}`;
    this.canvas.setAttribute("aria-label", `${this.spec.title} over time; at ${at}: ${told.join(", ")}`);
  }
}

/** Return an angle that a curve without jumps has moved far away as one between 0 and 360 degrees. */
function bounded(value, units) {
  if (units !== "°" || value === null || (value >= -180 && value < 360)) return value;
  return ((value % 360) + 360) % 360;
}

function nearest(values, wanted) {
  let best = 0;
  for (let k = 1; k < values.length; k += 1) {
    if (Math.abs(values[k] - wanted) < Math.abs(values[best] - wanted)) best = k;
  }
  return best;
}
