// Where the readings fall among what was expected of them: even if the belief is honest.

import { Axes } from "./axes.js";
import { chartFrame, drawWhole, element, heading } from "./dom.js";

const BINS = 10;

/** Counts the ranks of the readings up to the time that is shown, over those of the whole run. */
export class Histogram {
  constructor(data, theme, player, room) {
    Object.assign(this, { data, theme, player });
    this.refresh();
    this.told = element("li", {});
    const title = heading("Ranks of the readings", "number of readings");
    Object.assign(this, chartFrame(room, "ranks", [title]));
    this.legend.append(this.told);
    drawWhole(this, theme, player);
  }

  /** Look at the run's readings anew. */
  refresh() {
    const { row, rank } = this.data.readings;
    this.ranks = row.map((at, k) => ({ at, rank: rank[k] })).filter((one) => one.rank !== null);
  }

  counts(until) {
    const counts = new Array(BINS).fill(0);
    for (const { at, rank } of this.ranks) {
      if (at <= until) counts[Math.min(BINS - 1, Math.floor(rank * BINS))] += 1;
    }
    return counts;
  }

  draw() {
    if (!this.size) return;
    const { colours } = this.theme;
    const { context, width, height } = this.size;
    context.clearRect(0, 0, width, height);
    const all = this.counts(Infinity);
    const now = this.counts(this.player.row);
    const even = this.ranks.length / BINS;
    const [low, high] = likely(this.ranks.length, 1 / BINS);
    const axes = new Axes(context, width, height, [0, 1], [0, 1.08 * Math.max(high, ...all)], false);
    axes.drawGrid(colours, "rank");
    const bar = (counts, alpha) => counts.forEach((count, k) => {
      const [left, right] = [axes.toX(k / BINS) + 1.5, axes.toX((k + 1) / BINS) - 1.5];
      context.globalAlpha = alpha;
      context.fillStyle = colours.belief;
      context.fillRect(left, axes.toY(count), right - left, axes.bottom - axes.toY(count));
      context.globalAlpha = 1;
    });
    axes.drawBand([0, 1], [low, low], [high, high], colours.soft, 0.14);
    bar(all, 0.3);
    bar(now, 0.85);
    axes.drawLine([0, 1], [even, even], colours.soft, { width: 1.2, dash: [2, 3] });
    const sum = now.reduce((total, count) => total + count, 0);
    const text = `${sum} of ${this.ranks.length} readings; dotted: an honest belief, shaded: nine in ten of its bars`;
    this.told.textContent = text;
    if (this.player.playing) return;
    this.canvas.setAttribute("aria-label", `Histogram of ranks from 0 to 1: ${now.join(", ")}; ${text}`);
  }
}

/** Return the range in which nine in ten counts lie if each of `count` readings falls into a bin with a probability. */
export function likely(count, probability) {
  let term = (1 - probability) ** count;
  let sum = 0;
  let low = null;
  for (let k = 0; k <= count; k += 1) {
    sum += term;
    if (low === null && sum > 0.05) low = k;
    if (sum >= 0.95) return [low, k];
    term *= ((count - k) / (k + 1)) * (probability / (1 - probability));
  }
  // Of thousands of readings the first term is too small for the machine: their count is nearly normal.
  const [mean, spread] = [count * probability, Math.sqrt(count * probability * (1 - probability))];
  return [mean - 1.645 * spread, mean + 1.645 * spread];
}
