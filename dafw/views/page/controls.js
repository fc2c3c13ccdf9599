// The slider, the buttons and the keys that move the time.

import { tickLabel } from "./format.js";

const byId = (id) => document.getElementById(id);

/** Connect slider, buttons and keyboard to the player; `describe(row)` says in words what is shown. */
export function connectControls(player, time, describe) {
  const slider = byId("slider");
  slider.max = String(player.count - 1);
  slider.addEventListener("input", () => player.go(Number(slider.value)));
  byId("first").addEventListener("click", () => player.go(0));
  byId("last").addEventListener("click", () => player.go(player.count - 1));
  byId("play").addEventListener("click", () => player.toggle());
  byId("speed").addEventListener("change", (event) => {
    player.speed = Number(event.target.value);
  });
  document.addEventListener("keydown", (event) => onKey(event, player));

  player.onRow((row) => {
    byId("controls").hidden = player.count < 2;
    slider.max = String(player.count - 1);
    slider.value = String(row);
    if (!player.telling) return;
    const end = time.values[player.count - 1];
    byId("now").textContent = `t = ${tickLabel(time.values[row])} of ${tickLabel(end)} ${time.units}`;
    if (!player.playing) slider.setAttribute("aria-valuetext", describe(row));
  });
  player.onState((playing) => {
    byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    byId("play").classList.toggle("playing", playing);
    // While it plays nobody wants to hear every row.
    if (!playing) byId("spoken").textContent = describe(player.row);
  });
}

function onKey(event, player) {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const target = event.target;
  const tag = target.tagName;
  const isSlider = target.id === "slider";
  // Keys that a control uses itself are its own.
  if (tag === "SELECT" || tag === "TEXTAREA" || (tag === "INPUT" && !isSlider && target.type !== "checkbox")) return;
  if (event.key === " " && (tag === "BUTTON" || tag === "SUMMARY" || (tag === "INPUT" && !isSlider))) return;
  const stride = event.shiftKey ? 10 : 1;
  const actions = {
    " ": () => player.toggle(),
    ArrowLeft: () => player.go(player.row - stride),
    ArrowRight: () => player.go(player.row + stride),
    Home: () => player.go(0),
    End: () => player.go(player.count - 1),
  };
  const action = actions[event.key];
  if (!action) return;
  event.preventDefault();
  action();
}
