// The command, the tables, the configuration, and how exact the page is.

import { commandBlock } from "./command.js";
import { element } from "./dom.js";
import { tickLabel, withUnits } from "./format.js";

/** Fill the last section of the page. */
export function showWords(data) {
  const room = document.querySelector("#words .words");
  const wasOpen = room.querySelector("details")?.open ?? false;
  room.replaceChildren();
  const { words } = data;
  const started = "This run was started from Python: no command repeats it.";
  room.append(words.command ? repeating(words.command, data.kind) : element("p", { class: "wide" }, [started]));
  for (const { title, rows } of words.tables) {
    const lines = rows.map(([name, value]) => {
      return element("tr", {}, [element("th", { scope: "row" }, [name]), element("td", {}, [value])]);
    });
    room.append(element("table", {}, [element("caption", {}, [title]), element("tbody", {}, lines)]));
  }
  if (words.configuration) {
    const text = element("pre", { tabindex: "0" }, [words.configuration]);
    const details = element("details", { class: "wide" }, [element("summary", {}, ["Configuration"]), text]);
    details.open = wasOpen;
    room.append(details);
  }
  const notes = exactness(data);
  if (notes) room.append(element("p", { class: "wide hint", id: "exactness" }, [notes]));
}

function repeating(text, kind) {
  return commandBlock(`The command that repeats this ${kind}`, text).block;
}

/** Say how much the page's numbers differ from those of the run's file. */
function exactness({ fields, time, variable }) {
  if (!fields) return "";
  const shown = fields.panels.filter(({ key }) => !key.startsWith("smoothed"));
  const errors = shown.map(({ title, error }) => `${title.toLowerCase()} ${withUnits(error, variable.units)}`);
  const bits = fields.panels[0].bits;
  const [some, all] = [fields.rows.length, time.values.length];
  const sentences = [
    `Fields of ${variable.name} are rounded to ${bits} bits; at most they are off by: ${errors.join(", ")}.`,
    some === all ? "" : `Fields are shown for ${some} of ${all} times.`,
    "Curves have six digits.",
  ];
  return sentences.filter((sentence) => sentence).join(" ");
}

/** Return the line under the title. */
export function subtitle(data) {
  const { words, seed, name, time } = data;
  const end = time.values[time.values.length - 1];
  // Of a run that goes on the file says "interrupted".
  const status = data.live && !data.live.ended ? "" : words.status;
  const named = data.title.includes(name) ? "" : name;
  const parts = [named, seed === "" ? "" : `seed ${seed}`, status, `${tickLabel(end)} ${time.units}`];
  return [parts.filter((part) => part).join(" · "), words.error].filter((part) => part).join(": ");
}
