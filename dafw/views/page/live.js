// Follows a run that goes on: asks the server of the page for what is new, until the run has ended.

import { unpackField } from "./data.js";

const WAIT = 1000; // milliseconds between two questions

/** Ask again and again; `refresh(next)` is given new data, `say(text)` tells how it goes. */
export function followRun(state, refresh, say) {
  const ask = async () => {
    let answer;
    try {
      answer = await fetch(`data?state=${encodeURIComponent(state)}`);
    } catch {
      say("the server was closed; this is what it had");
      return;
    }
    if (answer.status === 200) {
      const next = await answer.json();
      state = next.live.state;
      await refresh(next);
      if (next.live.ended) {
        say(next.words.status);
        return;
      }
      say("following");
    } else if (answer.status !== 204) {
      say("the run cannot be read now; trying again");
    }
    setTimeout(ask, WAIT);
  };
  say("following");
  setTimeout(ask, WAIT);
}

/** Put new data into those that the page's views look at, keeping the objects that they hold. */
export async function take(data, next) {
  const values = await Promise.all((next.fields?.panels ?? []).map(unpackField));
  Object.assign(data.time, next.time);
  const whole = ["vehicles", "readings", "sources", "wind", "scores", "curves", "innovations", "words", "forecasts"];
  for (const key of whole) data[key] = next[key];
  if (data.fields && next.fields) Object.assign(data.fields, next.fields);
  return (next.fields?.panels ?? []).map((panel, k) => ({ ...panel, values: values[k] }));
}
