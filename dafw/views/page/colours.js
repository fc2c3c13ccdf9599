// Colours of fields (tables of 256) and of surprises (from blue over grey to orange).

import { bytesOf } from "./data.js";

/** Return a table's colours as the 256 numbers that an image's pixels are made of. */
export function colourTable(tables, name, dark) {
  const bytes = bytesOf(tables[dark ? name : `${name} light`]);
  const pixels = new Uint8ClampedArray(4 * 256);
  for (let k = 0; k < 256; k += 1) {
    for (let channel = 0; channel < 3; channel += 1) pixels[4 * k + channel] = bytes[3 * k + channel];
    pixels[4 * k + 3] = 255;
  }
  return new Uint32Array(pixels.buffer);
}

// Blue and orange differ for every kind of colour vision.
const SURPRISES = [
  [-3, [5, 72, 140]],
  [-1, [107, 174, 226]],
  [0, [240, 240, 240]],
  [1, [253, 184, 99]],
  [3, [166, 64, 0]],
];

/** Return the colour of a surprise: an innovation over its expected standard deviation. Null if it is missing. */
export function surpriseColour(value) {
  if (value === null || !Number.isFinite(value)) return null;
  const bounded = Math.min(3, Math.max(-3, value));
  const upper = Math.max(1, SURPRISES.findIndex(([at]) => at >= bounded));
  const [from, first] = SURPRISES[upper - 1];
  const [to, second] = SURPRISES[upper];
  const share = (bounded - from) / (to - from);
  const mixed = first.map((start, channel) => Math.round(start + share * (second[channel] - start)));
  return `rgb(${mixed.join(",")})`;
}

/** Fill a bar, from left to right, with the colours of a function of the share (0 to 1). */
export function fillBar(canvas, colourAt) {
  canvas.width = 256;
  canvas.height = 1;
  const context = canvas.getContext("2d");
  for (let k = 0; k < 256; k += 1) {
    context.fillStyle = colourAt(k / 255);
    context.fillRect(k, 0, 1, 1);
  }
}

/** Return a pixel of a table as CSS takes it. */
export function pixelColour(pixel) {
  return `rgb(${pixel & 255},${(pixel >> 8) & 255},${(pixel >> 16) & 255})`;
}
