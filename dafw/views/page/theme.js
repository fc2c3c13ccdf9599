// Light or dark: as the system says, until the switch is used. Canvases are told, because they do not follow CSS.

const LINES = ["truth", "belief", "free", "revised"];
const NAMES = ["text", "soft", "accent", ...LINES, "grid", "edge", "building", "wall", "route", "halo"];

/** What the page calls the stages of a state variable, in the order in which they are drawn. */
export const STAGES = { truth: "truth", mean: "belief", free: "free run", smoothed_mean: "as revised later" };

/** The colours of the page as canvases need them. */
export class Theme {
  constructor() {
    this.listeners = [];
    this.colours = {};
    const system = matchMedia("(prefers-color-scheme: dark)");
    this.chosen = false;
    this.set(system.matches);
    system.addEventListener("change", () => {
      if (!this.chosen) this.set(system.matches);
    });
    document.getElementById("theme").addEventListener("click", () => {
      this.chosen = true;
      this.set(!this.dark);
    });
  }

  /** Call a function whenever the theme changes. */
  onChange(listener) {
    this.listeners.push(listener);
  }

  set(dark) {
    this.dark = dark;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    document.getElementById("theme").textContent = dark ? "Light" : "Dark";
    document.getElementById("theme").setAttribute("aria-label", dark ? "Light colours" : "Dark colours");
    const style = getComputedStyle(document.documentElement);
    for (const name of NAMES) this.colours[name] = style.getPropertyValue(`--${name}`).trim();
    for (const listener of this.listeners) listener();
  }

  /** Return the colour of a line by what it shows. */
  line(role) {
    const names = { truth: "truth", mean: "belief", free: "free", smoothed_mean: "revised", dots: "free" };
    return this.colours[names[role] ?? "text"];
  }
}

/** Return how a line is dashed, by what it shows. */
export function dashes(role) {
  return { free: [6, 4], smoothed_mean: [2, 3] }[role] ?? [];
}

/** Return the class of the mark that stands for a line in a legend. */
export function style(role) {
  return { free: "dashed", smoothed_mean: "dotted" }[role] ?? "";
}
