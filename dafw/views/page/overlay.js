// What lies over a map: buildings, the source, routes, readings, the place that was chosen.

import { surpriseColour } from "./colours.js";
import { Trail } from "./trail.js";

/**
 * Draws what lies over a map; `place(x, y)` turns metres into pixels. What stays is drawn once on the canvas `walls`.
 * Where the page has no such canvas, it is copied below what moves: a browser takes time for every canvas of a page.
 */
export class Overlay {
  constructor(canvas, data, extent, key, walls = null) {
    this.canvas = canvas;
    this.walls = walls ?? document.createElement("canvas");
    this.copied = walls === null;
    this.trail = new Trail();
    this.context = canvas.getContext("2d");
    this.data = data;
    this.extent = extent;
    this.key = key;
    this.refresh();
  }

  /** Look at the run's data anew. */
  refresh() {
    this.wind = this.data.wind?.[this.key];
    this.colours = this.data.readings.row.map((_, k) => surpriseColour(this.data.readings.surprise[k]));
    this.trail.forget();
  }

  resize(width, height, ratio, colours) {
    for (const canvas of [this.walls, this.canvas]) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
    }
    this.trail.resize(this.canvas, ratio);
    this.width = width;
    this.height = height;
    this.outlines = new Path2D();
    for (const building of this.data.map.buildings) {
      building.forEach(([x, y], k) => {
        const at = this.place(x, y);
        if (k === 0) this.outlines.moveTo(...at);
        else this.outlines.lineTo(...at);
      });
      this.outlines.closePath();
    }
    this.drawWalls(colours);
  }

  /** Draw what stays: the buildings and a scale; everything that has colours of the page will be drawn anew. */
  drawWalls(colours) {
    this.trail.forget();
    if (!this.outlines) return;
    const context = this.walls.getContext("2d");
    context.clearRect(0, 0, this.width, this.height);
    context.fillStyle = colours.building;
    context.strokeStyle = colours.wall;
    context.lineWidth = 0.8;
    context.fill(this.outlines);
    context.stroke(this.outlines);
    this.drawScale(context, colours);
  }

  /** Draw a bar of a round length in the lower left corner. */
  drawScale(context, colours) {
    const metres = (0.22 * (this.extent[1] - this.extent[0]) * Math.max(this.width, 200)) / this.width;
    const power = 10 ** Math.floor(Math.log10(metres));
    const length = power * [5, 2, 1].find((factor) => factor * power <= metres);
    const width = (length / (this.extent[1] - this.extent[0])) * this.width;
    const text = length >= 1000 ? `${length / 1000} km` : `${Number(length.toPrecision(3))} m`;
    const [x, y] = [8, this.height - 8];
    for (const [style, thick] of [[colours.halo, 4], [colours.text, 1.6]]) {
      context.strokeStyle = style;
      context.lineWidth = thick;
      context.beginPath();
      context.moveTo(x, y - 4);
      context.lineTo(x, y);
      context.lineTo(x + width, y);
      context.lineTo(x + width, y - 4);
      context.stroke();
    }
    context.font = `${this.width < 240 ? 9 : 11}px system-ui, sans-serif`;
    context.textBaseline = "bottom";
    context.strokeStyle = colours.halo;
    context.lineWidth = 3;
    context.strokeText(text, x + 4, y - 2);
    context.fillStyle = colours.text;
    context.fillText(text, x + 4, y - 2);
  }

  place(x, y) {
    const [left, right, bottom, top] = this.extent;
    return [((x - left) / (right - left)) * this.width, ((top - y) / (top - bottom)) * this.height];
  }

  /** Draw the state at a row; `picked` is a place [x, y] in metres, or null. */
  draw(row, colours, withRoute, picked) {
    const { context } = this;
    context.clearRect(0, 0, this.width, this.height);
    if (this.copied) this.copy(this.walls);
    this.drawSources(row, colours);
    for (const mark of this.data.map.landmarks) this.drawLandmark(mark, colours);
    if (withRoute) {
      for (const vehicle of this.data.vehicles) this.drawRoute(vehicle, row, colours);
      this.drawReadings(row, colours);
      for (const vehicle of this.data.vehicles) this.drawVehicle(vehicle, row, colours);
    }
    if (this.wind) this.drawWind(row, colours);
    if (picked) this.drawPicked(picked, colours);
  }

  /** Copy a canvas of the same size. */
  copy(canvas) {
    this.context.drawImage(canvas, 0, 0, this.width, this.height);
  }

  dot(at, radius, fill, edge, width = 1, context = this.context) {
    context.beginPath();
    context.arc(at[0], at[1], radius, 0, 2 * Math.PI);
    context.fillStyle = fill;
    context.strokeStyle = edge;
    context.lineWidth = width;
    context.fill();
    context.stroke();
  }

  drawLandmark(mark, colours) {
    const at = this.place(mark.x, mark.y);
    if (mark.name === "release") this.dot(at, 5, "#ffd92f", "#000000", 1.2);
    else this.dot(at, 2.5, colours.soft, colours.halo);
  }

  drawSources(row, colours) {
    const sources = this.data.sources;
    if (!sources) return;
    sources.x[row].forEach((x, member) => {
      const y = sources.y[row][member];
      if (x !== null && y !== null) this.dot(this.place(x, y), 3, colours.belief, colours.halo);
    });
  }

  drawRoute(vehicle, row, colours) {
    const { context } = this;
    context.beginPath();
    for (let k = 0; k <= row; k += 1) {
      if (vehicle.x[k] === null) continue;
      context.lineTo(...this.place(vehicle.x[k], vehicle.y[k]));
    }
    context.lineJoin = "round";
    context.strokeStyle = colours.halo;
    context.lineWidth = 3.4;
    context.stroke();
    context.strokeStyle = colours.route;
    context.lineWidth = 1.4;
    context.stroke();
  }

  /** Draw the readings of the row, over those of the rows before. */
  drawReadings(row, colours) {
    const { row: rows, x, y } = this.data.readings;
    const dot = (context, k, radius, edge, width) => {
      if (x[k] === null || y[k] === null) return;
      this.dot(this.place(x[k], y[k]), radius, this.colours[k] ?? colours.free, edge, width, context);
    };
    const begin = firstFrom(rows, row);
    if (begin > 0) {
      this.trail.draw(begin, (context, k) => dot(context, k, 3, "#3a3f46", 0.7));
      this.copy(this.trail.canvas);
    }
    for (let k = begin; rows[k] === row; k += 1) dot(this.context, k, 4.5, colours.route, 1.6);
  }

  drawVehicle(vehicle, row, colours) {
    if (vehicle.x[row] === null) return;
    const [x, y] = this.place(vehicle.x[row], vehicle.y[row]);
    const { context } = this;
    context.beginPath();
    context.moveTo(x, y - 7);
    context.lineTo(x + 6, y + 5);
    context.lineTo(x - 6, y + 5);
    context.closePath();
    context.fillStyle = colours.route;
    context.strokeStyle = colours.halo;
    context.lineWidth = 1.6;
    context.stroke();
    context.fill();
  }

  /** Draw, in a corner, where the wind blows to; the arrow of the fastest wind of the run has the full length. */
  drawWind(row, colours) {
    const speed = this.wind.speed[row];
    const angle = this.wind.direction[row];
    if (speed === null || angle === null) return;
    const { context } = this;
    const most = Math.min(22, 0.09 * this.width);
    const half = (most * speed) / this.data.wind.fastest;
    context.save();
    context.translate(most + 6, most + 6);
    context.rotate(-angle);
    for (const [style, width] of [[colours.halo, 5], [colours.accent, 2.4]]) {
      context.beginPath();
      context.moveTo(-half, 0);
      context.lineTo(half, 0);
      context.moveTo(half - 6, -5);
      context.lineTo(half, 0);
      context.lineTo(half - 6, 5);
      context.lineCap = "round";
      context.lineJoin = "round";
      context.strokeStyle = style;
      context.lineWidth = width;
      context.stroke();
    }
    context.restore();
  }

  drawPicked(picked, colours) {
    const [x, y] = this.place(...picked);
    const { context } = this;
    for (const [style, width] of [[colours.halo, 4], [colours.accent, 2]]) {
      context.beginPath();
      context.moveTo(x - 9, y);
      context.lineTo(x + 9, y);
      context.moveTo(x, y - 9);
      context.lineTo(x, y + 9);
      context.strokeStyle = style;
      context.lineWidth = width;
      context.stroke();
    }
  }
}

/** Return how many of some ascending rows are less than `row`. */
function firstFrom(rows, row) {
  let [low, high] = [0, rows.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (rows[middle] < row) low = middle + 1;
    else high = middle;
  }
  return low;
}
