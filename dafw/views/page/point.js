// The values at a place over time: truth, belief with its band, free run.

import { Chart } from "./chart.js";
import { element } from "./dom.js";
import { formatNumber } from "./format.js";
import { triangleAt } from "./raster.js";
import { STAGES } from "./theme.js";

/** Shows the series at the place that was clicked on a map, or whose coordinates were given. */
export class PlaceSeries {
  constructor(data, mesh, maps, theme, player) {
    Object.assign(this, { data, mesh, maps, theme, player });
    this.room = document.getElementById("place");
    this.note = element("p", { class: "wide" });
    this.room.append(this.note);
    this.inputs = ["place-x", "place-y"].map((id) => document.getElementById(id));
    maps.onPick = (x, y) => this.show(x, y);
    for (const input of this.inputs) {
      input.addEventListener("change", () => {
        const [x, y] = this.inputs.map((one) => one.valueAsNumber);
        if (Number.isFinite(x) && Number.isFinite(y)) maps.pick(x, y);
      });
    }
  }

  /** Show the series at the same place anew. */
  refresh() {
    if (this.place) this.show(...this.place);
  }

  show(x, y) {
    this.place = [x, y];
    this.inputs[0].value = x.toFixed(1);
    this.inputs[1].value = y.toFixed(1);
    this.room.hidden = false;
    const found = triangleAt(this.mesh, x, y);
    const place = `x = ${formatNumber(x)} m, y = ${formatNumber(y)} m`;
    this.note.hidden = found !== null;
    if (!found) this.note.textContent = `At ${place} there is nothing to show: it is in a building, or off the map.`;
    if (this.chart) this.chart.figure.hidden = !found;
    if (!found) return;
    const spec = this.spec(found, place);
    if (this.chart) this.chart.replace(spec);
    else this.chart = new Chart(this.room, spec, this.data.time, this.player, this.theme);
  }

  spec({ corners, weights }, place) {
    const nodes = this.mesh.x.length;
    const { rows, logarithm } = this.data.fields;
    const count = this.data.time.values.length;
    const series = {};
    for (const { key, values } of Object.values(this.maps.fields)) {
      const one = new Array(count).fill(null);
      rows.forEach((row, at) => {
        const value = corners.reduce((sum, node, k) => sum + weights[k] * values[at * nodes + node], 0);
        one[row] = Number.isFinite(value) ? value : null;
      });
      series[key] = one;
    }
    const lines = Object.entries(STAGES)
      .filter(([key]) => series[key])
      .map(([role, label]) => ({ role, label, values: series[role], joined: true }));
    const spec = {
      id: "place",
      title: `${this.data.variable.title} at ${place}`,
      units: this.data.variable.units,
      remark: rows.length < count ? `recorded at ${rows.length} of ${count} times` : "",
      lines,
      log: this.data.fields.bottom === 0,
    };
    if (series.spread && series.mean) {
      const bound = (sign) => series.mean.map((value, k) => {
        const spread = series.spread[k];
        if (value === null || spread === null) return null;
        return logarithm ? value * Math.exp(sign * spread) : value + sign * spread;
      });
      spec.bands = [{ low: bound(-1), high: bound(1), label: "± spread" }];
    }
    return spec;
  }
}
