// The maps side by side: a field, what lies over it, its title.

import { showBars } from "./bars.js";
import { colourTable } from "./colours.js";
import { recordedRow } from "./data.js";
import { element, follow } from "./dom.js";
import { tickLabel, withUnits } from "./format.js";
import { Overlay } from "./overlay.js";
import { Painting, Raster } from "./raster.js";

const MOST_PIXELS = 120000; // of one map; a larger one is enlarged by the browser
const SPREAD = { magma: "viridis", viridis: "cividis", cividis: "magma" }; // the colours of the spread are others
const PAST = 0.05; // share of the run after which a field that is not of the time that is shown is pale
const LATER = { mean: "smoothed_mean", spread: "smoothed_spread" };

/** All maps of a run. `fields` are the decoded ones: {key, title, values}; without any there is one map of places. */
export class Maps {
  constructor(data, mesh, fields, theme, player) {
    Object.assign(this, { data, mesh, theme, player });
    this.extent = data.map.extent;
    this.nodes = mesh.x.length;
    this.fields = Object.fromEntries(fields.map((field) => [field.key, field]));
    this.rasters = new Map();
    this.picked = null;
    this.withRoute = true;
    this.later = false;
    this.colours = "magma";
    this.scale = "end";
    this.onPick = () => {};
    this.describe = () => ""; // what is shown at a row, in words
    this.room = document.querySelector("#maps .maps");
    const shown = fields.filter(({ key }) => !Object.values(LATER).includes(key));
    const panels = shown.length ? shown : [{ key: "places", title: "Places" }];
    this.panels = panels.map((field) => this.panel(field));
    this.retint();
    theme.onChange(() => this.retint());
    document.getElementById("maps").hidden = false;
    follow(this.room, player, { resize: () => this.resize(), draw: () => this.draw() });
  }

  panel({ key, title }) {
    const [left, right, bottom, top] = this.extent;
    const under = element("canvas", { role: "img" });
    const over = element("canvas", { "aria-hidden": "true" });
    const layers = element("div", { class: "layers" }, [under, over]);
    layers.style.aspectRatio = `${right - left} / ${top - bottom}`;
    const note = element("span", {});
    const caption = element("figcaption", {}, [title, note]);
    this.room.append(element("figure", { class: "map", "data-key": key }, [caption, layers]));
    layers.addEventListener("click", (event) => {
      const box = layers.getBoundingClientRect();
      const x = left + ((event.clientX - box.left - layers.clientLeft) / layers.clientWidth) * (right - left);
      const y = top - ((event.clientY - box.top - layers.clientTop) / layers.clientHeight) * (top - bottom);
      this.pick(x, y);
    });
    const overlay = new Overlay(over, this.data, this.extent, key);
    return { key, title, under, layers, note, overlay };
  }

  /** Return the field that a panel shows: the belief as it was known then, or as it was revised later. */
  field({ key }) {
    return this.fields[(this.later && LATER[key]) || key] ?? this.fields[key];
  }

  /** Show new fields of the same run. */
  refresh(fields) {
    for (const field of fields) Object.assign(this.fields[field.key] ?? {}, field, { peaks: undefined });
    for (const { overlay } of this.panels) overlay.refresh();
    showBars(this);
  }

  /** Mark a place, in metres, and tell who wants to know. */
  pick(x, y) {
    this.picked = [x, y];
    this.onPick(x, y);
    this.player.redraw();
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 3);
    for (const panel of this.panels) {
      const { clientWidth: width, clientHeight: height } = panel.layers;
      if (!width || !height) continue;
      panel.overlay.resize(width, height, ratio, this.theme.colours);
      if (!this.field(panel)) continue;
      panel.painting = this.painting(panel.under, width, height, ratio);
    }
  }

  /** Return what draws fields on a canvas that has a size in CSS pixels. */
  painting(canvas, width, height, ratio) {
    const factor = Math.min(ratio, Math.sqrt(MOST_PIXELS / (width * height)));
    return new Painting(canvas, this.raster(Math.round(width * factor), Math.round(height * factor)));
  }

  raster(width, height) {
    const key = `${width} ${height}`;
    if (!this.rasters.has(key)) {
      if (this.rasters.size > 3) this.rasters.clear();
      this.rasters.set(key, new Raster(this.mesh, this.extent, width, height));
    }
    return this.rasters.get(key);
  }

  /** Choose the colours anew, for another theme, map or scale. */
  retint() {
    const { dark } = this.theme;
    // A field that crosses zero has two colours, one for each sign.
    const crosses = this.data.fields !== null && this.data.fields.bottom < 0;
    this.table = colourTable(this.data.colours, crosses ? "signed" : this.colours, dark);
    this.spreadTable = colourTable(this.data.colours, SPREAD[this.colours], dark);
    showBars(this);
    for (const { overlay } of this.panels) overlay.drawWalls(this.theme.colours);
    this.player.redraw();
  }

  /** Return which row of the recorded fields shows the time. */
  fieldRow() {
    return recordedRow(this.data.fields.rows, this.player.row);
  }

  /** Return the lowest and the highest value that the colours of a panel tell apart. */
  range(panel) {
    const { bottom, top } = this.data.fields;
    const isSpread = panel.key === "spread";
    if (this.scale === "end") return isSpread ? [0, this.field(panel).peak] : [bottom, top];
    // The truth sets the scale of all but the spread; where there is none, the largest of them.
    const shared = this.panels.filter(({ key }) => key !== "spread");
    const truth = shared.filter(({ key }) => key === "truth");
    const leading = isSpread ? [panel] : truth.length ? truth : shared;
    const at = this.scale === "now" ? this.fieldRow() : null;
    const most = Math.max(...leading.map((one) => this.largest(this.field(one), at))) || 1;
    return [bottom < 0 && !isSpread ? -most : 0, most];
  }

  /** Return the largest size of a field at a recorded row, or of all rows if it is null. */
  largest(field, at) {
    field.peaks ??= peaks(field.values, this.nodes);
    return at === null ? Math.max(...field.peaks) : field.peaks[at];
  }

  draw() {
    const { row } = this.player;
    for (const panel of this.panels) {
      if (panel.painting) {
        const at = this.fieldRow();
        const [low, high] = this.range(panel);
        const table = panel.key === "spread" ? this.spreadTable : this.table;
        panel.painting.paint(this.field(panel).values, at * this.nodes, table, low, high);
        panel.under.classList.toggle("past", row - this.data.fields.rows[at] > PAST * this.player.count);
        if (this.player.telling) panel.note.textContent = this.caption(panel, row, this.data.fields.rows[at]);
      }
      if (panel.overlay.width) panel.overlay.draw(row, this.theme.colours, this.withRoute, this.picked);
    }
    if (this.scale === "now") showBars(this);
    if (this.player.playing) return; // a label that changes many times a second helps nobody
    for (const panel of this.panels) {
      panel.under.setAttribute("aria-label", `${panel.title}: map, ${this.describe(row)}`);
    }
  }

  /** Say what is known of a panel at a row: ERR, or that the field is of another time. */
  caption(panel, row, shown) {
    const { time, curves } = this.data;
    if (shown !== row) return `of t = ${tickLabel(time.values[shown])} ${time.units}`;
    const { key } = this.field(panel);
    const line = curves.find(({ id }) => id === "err")?.lines.find(({ role }) => role === key);
    return line ? `ERR ${withUnits(line.values[row], "%")}` : "";
  }
}

/** Return the largest size of each row. */
function peaks(values, nodes) {
  const found = [];
  for (let start = 0; start < values.length; start += nodes) {
    let most = 0;
    for (let k = start; k < start + nodes; k += 1) most = Math.abs(values[k]) > most ? Math.abs(values[k]) : most;
    found.push(most);
  }
  return found;
}
