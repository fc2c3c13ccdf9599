// The page of a study or a multirun: table, seeds, curves of each configuration.

import { Chart } from "./chart.js";
import { connectControls } from "./controls.js";
import { element } from "./dom.js";
import { tickLabel } from "./format.js";
import { Player } from "./player.js";
import { Seeds } from "./seeds.js";
import { Theme } from "./theme.js";
import { showWords } from "./words.js";

/** Show the results of many runs. */
export function showStudy(data) {
  const theme = new Theme();
  const player = new Player(data.time.values.length);
  document.getElementById("title").textContent = data.title;
  document.getElementById("subtitle").textContent = data.subtitle;
  document.getElementById("words-title").textContent = "The study";
  showTable(data.table);
  if (data.seeds) new Seeds(data.seeds);
  document.getElementById("curves-title").textContent = "ERR over time";
  document.getElementById("curves").hidden = !data.curves.length;
  const room = document.querySelector("#curves .charts");
  for (const spec of data.curves) new Chart(room, spec, data.time, player, theme);
  const describe = (row) => `t = ${tickLabel(data.time.values[row])} ${data.time.units}`;
  if (data.curves.length) connectControls(player, data.time, describe);
  if (data.failed.length) data.words.tables.push({ title: "Runs that failed", rows: data.failed });
  showWords(data);
  player.row = player.count - 1;
  player.draw();
  window.dafw = { player, theme };
}

function showTable({ headings, rows }) {
  const head = element("tr", {}, headings.map((text) => element("th", { scope: "col" }, [text])));
  const lines = rows.map(([name, ...cells]) => {
    return element("tr", {}, [element("th", { scope: "row" }, [name]), ...cells.map(cell)]);
  });
  const table = element("table", {}, [element("thead", {}, [head]), element("tbody", {}, lines)]);
  document.querySelector("#table .table").append(table);
  document.getElementById("table").hidden = false;
}

/** Return a cell; an interval in brackets gets a line of its own. */
function cell(text) {
  const [, value, interval] = /^(.*?)(?: (\(.* to .*\)))?$/.exec(text);
  return element("td", {}, interval ? [value, element("small", {}, [interval])] : [value]);
}
