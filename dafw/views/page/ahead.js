// Forecasts: a map of how probable it is that a threshold is exceeded, and when the named areas are reached.

import { bar } from "./bars.js";
import { colourTable, pixelColour } from "./colours.js";
import { unpackField } from "./data.js";
import { element, follow } from "./dom.js";
import { formatNumber, tickLabel, withUnits } from "./format.js";
import { Overlay } from "./overlay.js";

const COLOURS = "viridis";
const TIMES =
  " The table has the probability that an area is reached, and the times by which it has been reached with 10 %, 50 %, ... probability.";

/** Shows, at every time of the run, the latest forecast that had been made. */
export class Ahead {
  constructor(data, maps, theme, player) {
    Object.assign(this, { data, maps, theme, player });
    this.room = document.getElementById("forecast");
    document.getElementById("forecast-what").textContent = data.variable.title;
    this.note = this.room.querySelector(".hint");
    this.under = element("canvas", { role: "img" });
    const over = element("canvas", { "aria-hidden": "true" });
    this.layers = element("div", { class: "layers" }, [this.under, over]);
    const [left, right, bottom, top] = maps.extent;
    this.layers.style.aspectRatio = `${right - left} / ${top - bottom}`;
    this.caption = element("span", {});
    this.figure = element("figure", { class: "map", "data-key": "ahead" }, [
      element("figcaption", {}, ["Probability of exceedance", this.caption]),
      this.layers,
    ]);
    this.table = element("div", { class: "table", tabindex: "0" });
    this.overlay = new Overlay(over, data, maps.extent, "ahead");
    for (const id of ["threshold", "lead"]) this.select(id).addEventListener("change", () => this.draw());
    theme.onChange(() => this.retint());
  }

  /** Take the forecasts that the data have now; the first time, begin to draw. */
  async refresh() {
    const { forecasts } = this.data;
    if (!forecasts) return;
    this.values = await unpackField(forecasts.maps);
    this.fill("threshold", forecasts.thresholds, (one) => withUnits(one, forecasts.units === "1" ? "" : forecasts.units));
    this.fill("lead", forecasts.leads, (one) => `${tickLabel(one)} s`);
    if (!this.room.hidden) {
      this.draw();
      return;
    }
    this.room.querySelector(".maps").append(this.figure, this.table);
    this.room.hidden = false;
    this.select("lead").value = String(forecasts.leads.length - 1);
    this.retint();
    follow(this.layers, this.player, { resize: () => this.resize(), draw: () => this.draw() });
  }

  select(name) {
    return document.getElementById(`forecast-${name}`);
  }

  fill(name, values, text) {
    const list = this.select(name);
    if (list.length === values.length) return;
    list.replaceChildren(...values.map((one, k) => element("option", { value: String(k) }, [text(one)])));
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 3);
    const { clientWidth: width, clientHeight: height } = this.layers;
    if (!width || !height) return;
    this.overlay.resize(width, height, ratio, this.theme.colours);
    this.painting = this.maps.painting(this.under, width, height, ratio);
    this.shown = null;
  }

  retint() {
    if (this.room.hidden) return;
    this.colours = colourTable(this.data.colours, COLOURS, this.theme.dark);
    const colourAt = (share) => pixelColour(this.colours[Math.round(255 * share)]);
    this.room.querySelector(".bars").replaceChildren(bar("probability", colourAt, ["0 %", "50 %", "100 %"]));
    this.overlay.drawWalls(this.theme.colours);
    this.draw();
  }

  /** Return the number of the latest forecast at the time that is shown; -1 before the first. */
  latest() {
    const now = this.data.time.values[this.player.row];
    return this.data.forecasts.issues.findLastIndex((issue) => issue <= now * (1 + 1e-5) + 1e-9);
  }

  draw() {
    if (!this.painting) return;
    const { forecasts } = this.data;
    const [issue, threshold, lead] = [this.latest(), Number(this.select("threshold").value), Number(this.select("lead").value)];
    const what = [issue, threshold, lead, this.theme.dark, forecasts.issues.length].join();
    const isNew = what !== this.shown;
    if (isNew || this.data.sources) this.overlay.draw(this.player.row, this.theme.colours, false, null);
    if (!isNew) return; // the forecast of the row before
    this.shown = what;
    this.room.classList.toggle("waiting", issue < 0);
    if (issue < 0) {
      this.painting.clear();
      this.table.replaceChildren();
      this.caption.textContent = "";
      this.note.textContent = `The first forecast was made at t = ${tickLabel(forecasts.issues[0])} s.`;
      this.under.setAttribute("aria-label", "Probability of exceedance: no forecast yet");
      return;
    }
    const number = (issue * forecasts.leads.length + lead) * forecasts.thresholds.length + threshold;
    this.painting.paint(this.values, number * forecasts.maps.nodes, this.colours, 0, 1);
    const made = forecasts.issues[issue];
    this.caption.textContent = `at t = ${tickLabel(Number((made + forecasts.leads[lead]).toPrecision(6)))} s`;
    const kept = forecasts.every > 1 ? ` This page holds one in ${forecasts.every} forecasts, and the last one.` : "";
    this.note.textContent = `Made at t = ${tickLabel(made)} s, the latest at the time that is shown.${kept}${forecasts.areas ? TIMES : ""}`;
    const limit = this.select("threshold").selectedOptions[0].textContent;
    this.under.setAttribute("aria-label", `Probability of more than ${limit}, ${this.caption.textContent}: map`);
    this.table.replaceChildren(...(forecasts.areas ? [this.areas(forecasts, issue, threshold)] : []));
  }

  /** Return the table of the named areas. */
  areas({ areas, horizon }, issue, threshold) {
    const percent = (share) => `${tickLabel(Number((100 * share).toPrecision(3)))} %`;
    const heads = ["Area", `Within ${tickLabel(horizon)} s`];
    const row = (name, k) => {
      const times = areas.arrival[issue][threshold][k].map((time) => (time === null ? "–" : `${formatNumber(time)} s`));
      const cells = [percent(areas.probability[issue][threshold][k]), ...times];
      return element("tr", {}, [element("th", { scope: "row" }, breakable(name)), ...cells.map((one) => element("td", {}, [one]))]);
    };
    const titles = [...heads, ...areas.quantiles.map((share) => `By then: ${percent(share)}`)];
    return element("table", {}, [
      element("thead", {}, [element("tr", {}, titles.map((one) => element("th", { scope: "col" }, [one])))]),
      element("tbody", {}, areas.names.map(row)),
    ]);
  }
}

/** Return the parts of a name such as north_gate, which may stand in two lines. */
function breakable(name) {
  return name.split(/(?<=_)/).flatMap((part, k) => (k ? [element("wbr"), part] : [part]));
}
