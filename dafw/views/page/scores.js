// The policy's scores: how much each direction promised at the decision that led to the row that is shown.

import { chartFrame, drawWhole, element, heading } from "./dom.js";
import { formatNumber, tickLabel } from "./format.js";

const FULL = 2 * Math.PI;

/** Draws the scores of one vehicle as petals around it; the longest is the best. */
export class Scores {
  constructor(data, theme, player, room) {
    Object.assign(this, { data, theme, player });
    this.vehicle = 0;
    this.told = element("li", {});
    const title = heading(`Scores of the ${data.scores.kind}s at the decision`);
    Object.assign(this, chartFrame(room, "scores", [title, ...this.choice()]));
    this.legend.append(this.told);
    drawWhole(this, theme, player);
  }

  choice() {
    const count = this.data.vehicles.length;
    if (count < 2) return [];
    const options = this.data.vehicles.map((_, k) => element("option", { value: String(k) }, [`vehicle ${k + 1}`]));
    const select = element("select", { "aria-label": "Vehicle" }, options);
    select.addEventListener("change", () => {
      this.vehicle = Number(select.value);
      this.draw();
    });
    return [select];
  }

  /** Return the latest scores up to the row, and the row of the decision; null before the first. */
  latest() {
    const { values } = this.data.scores;
    for (let row = this.player.row; row >= 0; row -= 1) {
      const scores = values[row]?.[this.vehicle];
      if (scores && scores.some((score) => score !== null)) return { scores, row };
    }
    return null;
  }

  draw() {
    if (!this.size) return;
    const { colours } = this.theme;
    const { context, width, height } = this.size;
    context.clearRect(0, 0, width, height);
    const [x, y, reach] = [width / 2, height / 2, Math.min(width, height) / 2 - 16];
    const found = this.latest();
    context.strokeStyle = colours.grid;
    for (const share of [0.5, 1]) {
      context.beginPath();
      context.arc(x, y, share * reach, 0, FULL);
      context.stroke();
    }
    context.fillStyle = colours.soft;
    context.font = "11.5px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (const [text, dx, dy] of [["N", 0, -1], ["E", 1, 0], ["S", 0, 1], ["W", -1, 0]]) {
      context.fillText(text, x + dx * (reach + 9), y + dy * (reach + 9));
    }
    if (found) this.drawPetals(found, context, x, y, reach);
    else this.say("no decision yet");
  }

  drawPetals({ scores, row }, context, x, y, reach) {
    const { colours } = this.theme;
    const known = scores.filter((score) => score !== null);
    const most = Math.max(...known);
    const least = Math.min(0, ...known);
    const best = scores.indexOf(most);
    const width = FULL / scores.length;
    const shift = this.data.scores.kind === "sector" ? 0.5 : 0;
    scores.forEach((score, k) => {
      if (score === null) return;
      const middle = (k + shift) * width;
      const length = most > least ? reach * ((score - least) / (most - least)) : 0;
      context.beginPath();
      context.moveTo(x, y);
      // The screen's angles turn the other way.
      context.arc(x, y, Math.max(1, length), -middle - 0.46 * width, -middle + 0.46 * width);
      context.closePath();
      context.fillStyle = k === best ? colours.revised : colours.belief;
      context.globalAlpha = k === best ? 0.95 : 0.5;
      context.fill();
      context.globalAlpha = 1;
    });
    const { values, units } = this.data.time;
    const since = row === this.player.row ? "" : `, decided for t = ${tickLabel(values[row])} ${units}`;
    const blocked = scores.length - known.length;
    const ways = blocked ? `, ${blocked} of ${scores.length} ways blocked` : "";
    const bearing = (450 - Math.round((((best + shift) * width) / FULL) * 360)) % 360;
    this.say(`best: ${formatNumber(most)}, bearing ${bearing}°${ways}${since}`);
  }

  say(text) {
    this.told.textContent = text;
    if (!this.player.playing) this.canvas.setAttribute("aria-label", `Scores of the directions; ${text}`);
  }
}
