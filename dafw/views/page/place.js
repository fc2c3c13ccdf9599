// Puts the page together on which release and drones are placed: the map, the places, the command.

import { CIRCLE, mark } from "./bars.js";
import { commandBlock } from "./command.js";
import { unpackNumbers } from "./data.js";
import { element } from "./dom.js";
import { GroundMap } from "./ground.js";
import { Theme } from "./theme.js";

const STEP = 1; // metres that an arrow key moves; with shift ten times as many

const byId = (id) => document.getElementById(id);

/** What is placed where. A new place is shown once the server, which knows the walls exactly, has agreed to it. */
class Choice {
  constructor(data, map, command) {
    Object.assign(this, { data, map, command, asked: 0, chosen: 0 });
    this.spots = data.spots.map((spot, number) => this.spot(spot, number));
    byId("places").append(...this.spots.map(({ box }) => box));
    map.onPick = (x, y) => this.propose(this.chosen, x, y);
    byId("map").addEventListener("keydown", (event) => this.onKey(event));
    this.choose(0);
  }

  spot({ name, x, y, about }, number) {
    const radio = element("input", { type: "radio", name: "spot", value: String(number) });
    radio.addEventListener("change", () => this.choose(number));
    const inputs = ["x", "y"].map((axis) => {
      const input = element("input", { type: "number", step: "any", inputmode: "decimal", "aria-label": `${name}, ${axis} in metres` });
      input.addEventListener("change", () => {
        this.choose(number);
        this.propose(number, ...inputs.map((one) => one.valueAsNumber));
      });
      return input;
    });
    const words = element("p", {}, [about]);
    const numbers = inputs.map((input, k) => element("label", {}, ["xy"[k], " ", input, " m"]));
    const label = element("label", { class: "choose" }, [radio, name]);
    const box = element("div", { class: "spot" }, [label, element("div", { class: "numbers" }, numbers), words]);
    [x, y].forEach((value, k) => (inputs[k].value = String(value)));
    return { name, x, y, radio, inputs, words, box };
  }

  choose(number) {
    this.chosen = number;
    this.spots[number].radio.checked = true;
    byId("map").setAttribute("aria-label", `Map of the site. Arrow keys move the ${this.spots[number].name}`);
    this.map.draw(this.spots, number);
  }

  onKey(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const [east, north] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [0, 0];
    if (!east && !north) return;
    event.preventDefault();
    const step = event.shiftKey ? 10 * STEP : STEP;
    const { x, y } = this.wanted ?? this.spots[this.chosen]; // the last place that was asked for, if keys are quick
    this.propose(this.chosen, x + step * east, y + step * north);
  }

  /** Ask whether something can be at a place; put it there, or say why not. */
  async propose(number, x, y) {
    const round = (value) => Math.round(10 * value) / 10;
    const moved = { x: round(x), y: round(y) };
    this.asked += 1;
    const mine = this.asked;
    this.wanted = moved;
    const query = new URLSearchParams();
    this.spots.forEach((spot, k) => {
      const at = k === number ? moved : spot;
      query.append("at", `${at.x},${at.y}`);
    });
    let answer;
    try {
      const response = await fetch(`command?${query}`);
      answer = response.ok ? await response.json() : { problem: `The server refused: ${await response.text()}` };
    } catch {
      answer = { problem: "The server was closed: start dafw site preview again." };
    }
    if (mine !== this.asked) return; // something else was asked for meanwhile
    this.wanted = null;
    if (answer.problem) this.refuse(number, moved, answer.problem);
    else this.accept(number, moved, answer);
    this.map.draw(this.spots, this.chosen, answer.problem ? moved : null);
  }

  accept(number, at, answer) {
    Object.assign(this.spots[number], at);
    this.fill(number);
    this.spots.forEach((spot, k) => (spot.words.textContent = answer.about[k]));
    this.command.show(answer.command);
    byId("refused").hidden = true;
    byId("spoken").textContent = answer.about[number];
  }

  refuse(number, at, problem) {
    this.fill(number);
    byId("refused").textContent = problem;
    byId("refused").hidden = false;
  }

  fill(number) {
    const { inputs, x, y } = this.spots[number];
    [x, y].forEach((value, k) => (inputs[k].value = String(value)));
  }
}

function showLegend(data) {
  const marks = [
    mark(CIRCLE, "#ffd92f", "release, with its radius"),
    ...(data.spots.length > 1 ? [mark("M7 1 13 12H1z", "var(--route)", "drone")] : []),
    mark("M1 1h12v12H1z", "var(--building)", "building"),
    ...(data.changes.added.length ? [mark("M1 1h12v12H1z", "var(--added)", "filled: hole, yard or gap")] : []),
    ...(data.changes.removed.length ? [mark("M1 1h12v12H1z", "var(--removed)", "left out: in the rim, too small or too thin")] : []),
    ...(data.changes.crossing.length ? [mark("M1 5h12v4H1z", "var(--revised)", "repaired: crossed itself")] : []),
    mark("M1 6h3.5v2H1zM6 6h3.5v2H6zM11 6h2v2h-2z", "var(--soft)", "rim, kept free of buildings"),
    ...data.winds.map(({ name, role }) => mark("M1 5.5h7V2l5 5-5 5V8.5H1z", `var(--${role})`, name)),
  ];
  document.querySelector("#maps .marks").replaceChildren(...marks);
}

function showWords(data) {
  const lists = data.words.map(({ title, lines }) => {
    return element("div", {}, [element("h3", {}, [title]), element("ul", {}, lines.map((line) => element("li", {}, [line])))]);
  });
  document.querySelector("#words .words").append(...lists);
  byId("attribution").textContent = data.attribution;
  byId("attribution").hidden = !data.attribution;
}

async function show() {
  const data = JSON.parse(byId("data").textContent);
  const theme = new Theme();
  byId("title").textContent = data.title;
  byId("subtitle").textContent = data.subtitle;
  const mesh = {
    x: await unpackNumbers(data.map.x, Float32Array),
    y: await unpackNumbers(data.map.y, Float32Array),
    triangles: await unpackNumbers(data.map.triangles, Uint32Array),
  };
  const map = new GroundMap(data, mesh, theme);
  const command = commandBlock("The command that runs it", data.command);
  byId("run").append(command.block);
  showLegend(data);
  showWords(data);
  const choice = new Choice(data, map, command);
  for (const id of ["mesh", "changes"]) byId(id).addEventListener("change", () => map.drawUnder());
  byId("mesh").parentElement.hidden = !mesh.triangles.length;
  byId("changes").parentElement.hidden = !Object.values(data.changes).some((some) => some.length);
  window.dafw = { choice, map, theme };
  document.documentElement.dataset.ready = "yes";
}

show().catch((error) => {
  byId("problem").textContent = `This page cannot be shown: ${error.message}. It needs a browser of 2023 or later.`;
  byId("problem").hidden = false;
  throw error;
});
