// What the colours and the marks of the maps mean.

import { fillBar, pixelColour, surpriseColour } from "./colours.js";
import { element } from "./dom.js";
import { formatNumber } from "./format.js";

/** Draw the bars of all colours that the maps use, as they are now. */
export function showBars(maps) {
  const { data, panels } = maps;
  const bars = [];
  const first = panels.find((panel) => panel.key !== "spread" && maps.field(panel));
  const spread = panels.find((panel) => panel.key === "spread");
  const { name, units } = data.variable;
  if (first) bars.push(fieldBar(maps, first, maps.table, named(name, units)));
  if (spread) {
    const title = data.fields.logarithm ? `spread of the logarithm of ${name}` : named(`spread of ${name}`, units);
    bars.push(fieldBar(maps, spread, maps.spreadTable, title));
  }
  if (maps.withRoute && data.readings.surprise?.some((value, k) => value !== null && data.readings.x[k] !== null)) {
    const title = "readings less expected, in standard deviations";
    bars.push(bar(title, (share) => surpriseColour(6 * share - 3), ["−3 and less", "0", "3 and more"]));
  }
  document.querySelector("#maps .bars").replaceChildren(...bars);
}

/** Fill the list of marks that stand on the maps. */
export function showMarks(data) {
  const marks = [];
  const { landmarks } = data.map;
  if (data.vehicles.length) marks.push(mark("M7 1 13 12H1z", "var(--route)", "vehicle and its route"));
  if (landmarks.some(({ name }) => name === "release")) marks.push(mark(CIRCLE, "#ffd92f", "release"));
  if (data.readings.x?.some((x) => x !== null)) marks.push(mark(CIRCLE, "#8a9097", "reading"));
  if (data.sources) marks.push(mark(CIRCLE, "var(--belief)", "where members expect the source"));
  if (data.wind) marks.push(mark("M1 5.5h7V2l5 5-5 5V8.5H1z", "var(--accent)", "wind"));
  document.querySelector("#maps .marks").replaceChildren(...marks);
}

export const CIRCLE = "M12 7a5 5 0 1 1-10 0 5 5 0 0 1 10 0z";

/** Return an entry of a legend: the outline of a mark in a square of 14, its colour, and what it means. */
export function mark(path, colour, label) {
  const space = "http://www.w3.org/2000/svg";
  const drawing = document.createElementNS(space, "svg");
  drawing.setAttribute("viewBox", "0 0 14 14");
  drawing.setAttribute("aria-hidden", "true");
  const shape = document.createElementNS(space, "path");
  shape.setAttribute("d", path);
  shape.style.fill = colour;
  shape.style.stroke = "var(--wall)";
  drawing.append(shape);
  return element("li", {}, [drawing, label]);
}

function named(name, units) {
  return units ? `${name} (${units})` : name;
}

function fieldBar(maps, panel, table, title) {
  const [low, high] = maps.range(panel);
  const beyond = maps.largest(maps.field(panel), null) > high * 1.001;
  const least = `${formatNumber(low)}${beyond && low < 0 ? " and less" : ""}`;
  const most = `${formatNumber(high)}${beyond ? " and more" : ""}`;
  const colourAt = (share) => pixelColour(table[Math.round(255 * share)]);
  return bar(title, colourAt, [least, formatNumber((low + high) / 2), most]);
}

/** Return a bar of colours with its title above and labels below. */
export function bar(title, colourAt, labels) {
  const canvas = element("canvas", { "aria-hidden": "true" });
  fillBar(canvas, colourAt);
  const ends = element("div", { class: "ends" }, labels.map((text) => element("span", {}, [text])));
  return element("div", { class: "bar" }, [title, canvas, ends]);
}
