// The scales, grid and labels of a chart, and its lines and bands.

import { powerTicks, roundTicks, tickLabel } from "./format.js";

const FONT = '11.5px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif';

/** A rectangle of a canvas with a horizontal and a vertical scale. */
export class Axes {
  /** `x` and `y` are [low, high]; with `log` the vertical scale is logarithmic. Sizes are in CSS pixels. */
  constructor(context, width, height, x, y, log) {
    Object.assign(this, { context, width, height, x, y, log });
    context.font = FONT;
    const count = Math.max(2, Math.floor((height - 30) / 32));
    this.ticks = log ? powerTicks(y[0], y[1], count) : roundTicks(y[0], y[1], count);
    const labels = this.ticks.map(tickLabel);
    this.left = Math.ceil(Math.max(24, ...labels.map((text) => context.measureText(text).width)) + 8);
    this.right = width - 10;
    this.top = 6;
    this.bottom = height - 22;
    this.labels = labels;
  }

  toX(value) {
    return this.left + ((value - this.x[0]) / (this.x[1] - this.x[0] || 1)) * (this.right - this.left);
  }

  toY(value) {
    const [low, high] = this.log ? this.y.map(Math.log) : this.y;
    const share = ((this.log ? Math.log(value) : value) - low) / (high - low || 1);
    return this.bottom - share * (this.bottom - this.top);
  }

  /** Return the value on the horizontal scale at a distance from the left edge of the canvas. */
  fromX(pixel) {
    return this.x[0] + ((pixel - this.left) / (this.right - this.left)) * (this.x[1] - this.x[0]);
  }

  /** Draw grid and labels; `units` stand at the end of the horizontal axis. */
  drawGrid(colours, units) {
    const { context } = this;
    context.font = FONT;
    context.lineWidth = 1;
    context.strokeStyle = colours.grid;
    context.fillStyle = colours.soft;
    context.textAlign = "right";
    context.textBaseline = "middle";
    this.ticks.forEach((tick, k) => {
      const y = Math.round(this.toY(tick)) + 0.5;
      this.stroke([[this.left, y], [this.right, y]]);
      context.fillText(this.labels[k], this.left - 6, y);
    });
    context.textBaseline = "top";
    const count = Math.max(2, Math.floor((this.right - this.left) / 50));
    const ticks = roundTicks(this.x[0], this.x[1], count);
    const edge = this.right - context.measureText(units).width - 6;
    for (const tick of ticks) {
      const x = Math.round(this.toX(tick)) + 0.5;
      this.stroke([[x, this.top], [x, this.bottom]]);
      const text = tickLabel(tick);
      const half = context.measureText(text).width / 2;
      context.textAlign = "center";
      if (!units || x + half < edge) context.fillText(text, x, this.bottom + 6);
    }
    context.textAlign = "right";
    context.fillText(units, this.right, this.bottom + 6);
    context.strokeStyle = colours.edge;
    this.stroke([[this.left, this.bottom + 0.5], [this.right, this.bottom + 0.5]]);
  }

  stroke(points) {
    const { context } = this;
    context.beginPath();
    points.forEach(([x, y]) => context.lineTo(x, y));
    context.stroke();
  }

  /** Draw only inside of the axes what a function draws. */
  clipped(draw) {
    const { context } = this;
    context.save();
    context.beginPath();
    context.rect(this.left, this.top - 1, this.right - this.left, this.bottom - this.top + 2);
    context.clip();
    draw();
    context.restore();
  }

  visible(value) {
    return value !== null && Number.isFinite(value) && (!this.log || value > 0);
  }

  /** Draw a line through the values; a missing one interrupts it, unless it is `joined`. */
  drawLine(xs, values, colour, { width = 1.8, dash = [], joined = false } = {}) {
    const { context } = this;
    context.beginPath();
    let down = false;
    values.forEach((value, k) => {
      if (!this.visible(value)) {
        down = down && joined;
        return;
      }
      if (down) context.lineTo(this.toX(xs[k]), this.toY(value));
      else context.moveTo(this.toX(xs[k]), this.toY(value));
      down = true;
    });
    context.setLineDash(dash);
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.stroke();
    context.setLineDash([]);
  }

  drawDots(xs, values, colour) {
    const { context } = this;
    context.fillStyle = colour;
    context.globalAlpha = 0.55;
    values.forEach((value, k) => {
      if (!this.visible(value)) return;
      context.beginPath();
      context.arc(this.toX(xs[k]), this.toY(value), 1.8, 0, 2 * Math.PI);
      context.fill();
    });
    context.globalAlpha = 1;
  }

  /** Fill between two lines; where one of them is missing there is a gap. */
  drawBand(xs, low, high, colour, alpha = 0.2) {
    const { context } = this;
    const floor = (value) => (this.log && !(value > 0) ? this.y[0] : value);
    context.fillStyle = colour;
    context.globalAlpha = alpha;
    let begin = null;
    for (let k = 0; k <= xs.length; k += 1) {
      const known = k < xs.length && [low[k], high[k]].every((end) => end !== null && Number.isFinite(end));
      if (known && begin === null) begin = k;
      if (known || begin === null) continue;
      context.beginPath();
      for (let j = begin; j < k; j += 1) context.lineTo(this.toX(xs[j]), this.toY(floor(high[j])));
      for (let j = k - 1; j >= begin; j -= 1) context.lineTo(this.toX(xs[j]), this.toY(floor(low[j])));
      context.closePath();
      context.fill();
      begin = null;
    }
    context.globalAlpha = 1;
  }
}

/** Return [low, high] for lines, bands and a level that a chart shows; a wide band does not flatten the lines. */
export function verticalRange({ lines, bands = [], reference, floor, top }, log) {
  const usable = (value) => value !== null && Number.isFinite(value) && (!log || value > 0);
  const values = lines.flatMap((line) => line.values).filter(usable);
  if (!values.length) return log ? [0.1, 10] : [0, 1];
  let [low, high] = extremes(values);
  const room = log ? high / low : high - low || Math.abs(high) || 1;
  for (const band of bands) {
    // A band that is wide for a short while is cut; one that stays wide is shown.
    const lows = band.low.filter(usable).sort((a, b) => a - b);
    const highs = band.high.filter(usable).sort((a, b) => a - b);
    const [below, above] = log ? [low / room, high * room] : [low - room, high + room];
    if (lows.length) low = Math.min(low, Math.max(lows[0], below), share(lows, 0.25));
    if (highs.length) high = Math.max(high, Math.min(highs.at(-1), above), share(highs, 0.75));
  }
  if (reference && usable(reference.value)) {
    const { value } = reference;
    const near = log ? true : value <= high + 0.6 * room && value >= low - 0.6 * room;
    if (near) [low, high] = [Math.min(low, value), Math.max(high, value)];
  }
  if (log) return [low / 1.3, high * 1.3];
  if (top !== undefined) return [floor, top];
  if (floor !== undefined && floor !== null && low >= floor) return [floor, high + 0.05 * (high - floor || 1)];
  const margin = 0.06 * (high - low || Math.abs(high) || 1);
  return [low - margin, high + margin];
}

/** Return the value below which a share of ascending values lies. */
function share(sorted, part) {
  return sorted[Math.round(part * (sorted.length - 1))];
}

function extremes(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  return [low, high];
}
