// Puts the page together from its data.

import { showBars, showMarks } from "./bars.js";
import { Chart } from "./chart.js";
import { connectControls } from "./controls.js";
import { unpackField, unpackNumbers } from "./data.js";
import { tickLabel, withUnits } from "./format.js";
import { Histogram } from "./histogram.js";
import { Maps } from "./maps.js";
import { Player } from "./player.js";
import { PlaceSeries } from "./point.js";
import { Profile } from "./profile.js";
import { Scores } from "./scores.js";
import { showStudy } from "./study.js";
import { Theme } from "./theme.js";
import { showWords, subtitle } from "./words.js";

const byId = (id) => document.getElementById(id);

async function showRun(data) {
  const theme = new Theme();
  const player = new Player(data.time.values.length);
  byId("title").textContent = data.title;
  byId("subtitle").textContent = subtitle(data);
  const panels = data.fields?.panels ?? [];
  const unpacked = await Promise.all(panels.map(unpackField));
  const fields = panels.map((panel, k) => ({ ...panel, values: unpacked[k] }));
  const maps = data.map ? await showMaps(data, fields, theme, player) : null;
  if (!data.map && fields.length) new Profile(data, fields, theme, player);

  const describe = (row) => described(data, row);
  connectControls(player, data.time, describe);
  if (maps) player.onState((playing) => playing || maps.describe(describe(player.row)));
  showCharts("curves", data.curves, data, theme, player);
  showCharts("trust", data.innovations, data, theme, player);
  byId("innovation-hint").hidden = !data.innovations.length;
  const room = document.querySelector("#trust .charts");
  if (data.readings.row.length && data.readings.rank.some((rank) => rank !== null)) new Histogram(data, theme, player, room);
  if (data.scores) new Scores(data, theme, player, room);
  byId("trust").hidden = !room.childElementCount;
  showWords(data);
  player.row = 0;
  player.draw();
  maps?.describe(describe(0));
  window.dafw = { player, theme, maps };
}

async function showMaps(data, fields, theme, player) {
  const mesh = {
    x: await unpackNumbers(data.map.x, Float32Array),
    y: await unpackNumbers(data.map.y, Float32Array),
    triangles: await unpackNumbers(data.map.triangles, Uint32Array),
  };
  const maps = new Maps(data, mesh, mesh.triangles.length ? fields : [], theme, player);
  const hasFields = mesh.triangles.length > 0;
  showMarks(data);
  if (hasFields) new PlaceSeries(data, mesh, fields, maps, theme, player);
  document.querySelector("#maps .hint").hidden = !hasFields;
  byId("scale-choice").hidden = !hasFields;
  byId("colours-choice").hidden = !hasFields || data.fields.bottom < 0;
  byId("route-choice").hidden = !data.vehicles.length && !data.readings.row.length;
  byId("colours").addEventListener("change", (event) => {
    maps.colours = event.target.value;
    maps.retint();
  });
  byId("scale").addEventListener("change", (event) => {
    maps.scale = event.target.value;
    maps.retint();
  });
  byId("belief-choice").hidden = !maps.fields.smoothed_mean;
  byId("belief").addEventListener("change", (event) => {
    maps.later = event.target.value === "later";
    maps.retint();
  });
  byId("route").addEventListener("change", (event) => {
    maps.withRoute = event.target.checked;
    showBars(maps);
    player.redraw();
  });
  return maps;
}

function showCharts(id, specs, data, theme, player) {
  const room = document.querySelector(`#${id} .charts`);
  byId(id).hidden = !specs.length;
  for (const spec of specs) new Chart(room, spec, data.time, player, theme);
}

/** Say in words what is shown at a row. */
function described(data, row) {
  const parts = [`t = ${tickLabel(data.time.values[row])} ${data.time.units}`];
  const err = data.curves.find((chart) => chart.id === "err");
  const line = err?.lines.find(({ role }) => role === "mean");
  if (line) parts.push(`ERR of the belief ${withUnits(line.values[row], "%")}`);
  return parts.join(", ");
}

function complain(error) {
  const problem = byId("problem");
  problem.textContent = `This page cannot be shown: ${error instanceof Error ? error.message : error}. It needs a browser of 2023 or later.`;
  problem.hidden = false;
  throw error;
}

async function show() {
  const data = JSON.parse(byId("data").textContent);
  await (data.kind === "study" ? showStudy(data) : showRun(data));
  document.documentElement.dataset.ready = "yes";
}

show().catch(complain);
