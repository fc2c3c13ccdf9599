// Puts the page together from its data.

import { Ahead } from "./ahead.js";
import { showMarks } from "./bars.js";
import { Chart } from "./chart.js";
import { connectControls } from "./controls.js";
import { unpackField, unpackNumbers } from "./data.js";
import { tickLabel, withUnits } from "./format.js";
import { Histogram } from "./histogram.js";
import { followRun, take } from "./live.js";
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
  const describe = (row) => described(data, row);
  const views = data.map ? await showMaps(data, fields, theme, player) : {};
  const { maps } = views;
  if (maps) maps.describe = describe;
  if (!data.map && fields.length) views.profile = new Profile(data, fields, theme, player);
  connectControls(player, data.time, describe);
  views.charts = new Map();
  showCharts(data, views, theme, player);
  showWords(data);
  if (data.live && !data.live.ended) {
    player.row = player.count - 1;
    followRun(data.live.state, (next) => refresh(data, next, views, theme, player), (text) => {
      byId("subtitle").textContent = [subtitle(data), text].join(" · ");
    });
  }
  player.draw();
  window.dafw = { player, theme, maps };
}

/** Show more of a run that goes on. */
async function refresh(data, next, views, theme, player) {
  const fields = await take(data, next);
  views.maps?.refresh(fields);
  if (views.maps) showLegend(data);
  views.profile?.refresh(fields);
  views.histogram?.refresh();
  player.extend(data.time.values.length);
  showCharts(data, views, theme, player);
  views.place?.refresh();
  await views.ahead?.refresh();
  showWords(data);
}

async function showMaps(data, fields, theme, player) {
  const mesh = {
    x: await unpackNumbers(data.map.x, Float32Array),
    y: await unpackNumbers(data.map.y, Float32Array),
    triangles: await unpackNumbers(data.map.triangles, Uint32Array),
  };
  const hasFields = mesh.triangles.length > 0;
  const maps = new Maps(data, mesh, hasFields ? fields : [], theme, player);
  const ahead = hasFields ? new Ahead(data, maps, theme, player) : null;
  await ahead?.refresh();
  const place = hasFields ? new PlaceSeries(data, mesh, maps, theme, player) : null;
  showLegend(data);
  document.querySelector("#maps .hint").hidden = !hasFields;
  byId("scale-choice").hidden = !hasFields;
  byId("colours-choice").hidden = !hasFields || data.fields.bottom < 0;
  byId("belief-choice").hidden = !maps.fields.smoothed_mean;
  const changes = {
    colours: ({ value }) => Object.assign(maps, { colours: value }),
    scale: ({ value }) => Object.assign(maps, { scale: value }),
    belief: ({ value }) => Object.assign(maps, { later: value === "later" }),
    route: ({ checked }) => Object.assign(maps, { withRoute: checked }),
  };
  for (const [id, change] of Object.entries(changes)) {
    byId(id).addEventListener("change", (event) => {
      change(event.target);
      maps.retint();
    });
  }
  return { maps, place, ahead };
}

/** Explain the marks on the maps; a run has no readings when it begins. */
function showLegend(data) {
  showMarks(data);
  byId("route-choice").hidden = !data.vehicles.length && !data.readings.row.length;
}

/** Show every chart that there are data for; a chart that is there already gets the new data. */
function showCharts(data, views, theme, player) {
  for (const [id, specs] of [["curves", data.curves], ["trust", data.innovations]]) {
    const room = document.querySelector(`#${id} .charts`);
    for (const spec of specs) {
      if (views.charts.has(spec.id)) views.charts.get(spec.id).replace(spec);
      else views.charts.set(spec.id, new Chart(room, spec, data.time, player, theme));
    }
  }
  const room = document.querySelector("#trust .charts");
  const ranked = data.readings.rank?.some((rank) => rank !== null);
  if (ranked) views.histogram ??= new Histogram(data, theme, player, room);
  if (data.scores) views.scores ??= new Scores(data, theme, player, room);
  byId("curves").hidden = !data.curves.length;
  byId("trust").hidden = !room.childElementCount;
  byId("innovation-hint").hidden = !data.innovations.length;
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
  const told = error instanceof Error ? error.message : error;
  problem.textContent = `This page cannot be shown: ${told}. It needs a browser of 2023 or later.`;
  problem.hidden = false;
  throw error;
}

async function show() {
  const data = JSON.parse(byId("data").textContent);
  await (data.kind === "study" ? showStudy(data) : showRun(data));
  document.documentElement.dataset.ready = "yes";
}

show().catch(complain);
