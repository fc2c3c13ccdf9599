// Draws a field that is linear in the triangles of a mesh. For each pixel it is found once which triangle covers it and
// how much each corner counts; a new time then costs two products a pixel, and nothing where there was nothing to see
// and still is nothing. This needs no graphics hardware.

/** The pixels of one size of a map, and the corners that their values come from. */
export class Raster {
  /** `mesh` has x, y (nodes) and triangles (3 corners each), `extent` is [left, right, bottom, top]; all in metres. */
  constructor(mesh, extent, width, height) {
    this.width = width;
    this.height = height;
    const [left, right, bottom, top] = extent;
    const toX = width / (right - left);
    const toY = height / (top - bottom);
    const count = mesh.triangles.length / 3;
    const owner = new Int32Array(width * height).fill(-1);
    const first = new Float32Array(width * height);
    const second = new Float32Array(width * height);
    const sizes = new Int32Array(count + 1);
    for (let k = 0; k < count; k += 1) {
      const [a, b, c] = [mesh.triangles[3 * k], mesh.triangles[3 * k + 1], mesh.triangles[3 * k + 2]];
      const [ax, ay] = [(mesh.x[a] - left) * toX, (top - mesh.y[a]) * toY];
      const [bx, by] = [(mesh.x[b] - left) * toX, (top - mesh.y[b]) * toY];
      const [cx, cy] = [(mesh.x[c] - left) * toX, (top - mesh.y[c]) * toY];
      const double = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay);
      if (double === 0) continue;
      const y0 = Math.max(0, Math.ceil(Math.min(ay, by, cy) - 0.5));
      const y1 = Math.min(height - 1, Math.floor(Math.max(ay, by, cy) - 0.5));
      const x0 = Math.max(0, Math.ceil(Math.min(ax, bx, cx) - 0.5));
      const x1 = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx) - 0.5));
      for (let py = y0; py <= y1; py += 1) {
        for (let px = x0; px <= x1; px += 1) {
          const [x, y] = [px + 0.5, py + 0.5];
          const wa = ((bx - x) * (cy - y) - (cx - x) * (by - y)) / double;
          const wb = ((cx - x) * (ay - y) - (ax - x) * (cy - y)) / double;
          // Rounding must leave no gap between neighbours.
          if (wa < -1e-6 || wb < -1e-6 || wa + wb > 1 + 1e-6) continue;
          const pixel = py * width + px;
          owner[pixel] = k;
          first[pixel] = wa;
          second[pixel] = wb;
        }
      }
    }
    for (const k of owner) if (k >= 0) sizes[k + 1] += 1;
    // The pixels of triangle k are those from number ends[k] up to ends[k + 1].
    for (let k = 0; k < count; k += 1) sizes[k + 1] += sizes[k];
    this.ends = sizes;
    this.corners = mesh.triangles;
    this.pixels = new Int32Array(this.ends[count]);
    this.weights = new Float32Array(2 * this.ends[count]);
    const next = this.ends.slice();
    owner.forEach((k, pixel) => {
      if (k < 0) return;
      const at = next[k]++;
      this.pixels[at] = pixel;
      this.weights[2 * at] = first[pixel];
      this.weights[2 * at + 1] = second[pixel];
    });
  }

  /**
   * Colour `image` (one number a pixel) by the nodes' values, which begin at `start`; missing values stay empty. `blank`
   * has a 1 for every triangle whose pixels have the lowest colour already.
   */
  paint(image, values, start, table, low, high, blank) {
    const { pixels, corners, weights, ends } = this;
    const scale = 255 / (high - low);
    const least = low + 1 / scale; // all below has the lowest colour
    for (let k = 0; k < blank.length; k += 1) {
      const a = values[start + corners[3 * k]];
      const b = values[start + corners[3 * k + 1]];
      const c = values[start + corners[3 * k + 2]];
      const end = ends[k + 1];
      if (a < least && b < least && c < least) {
        if (!blank[k]) for (let at = ends[k]; at < end; at += 1) image[pixels[at]] = table[0];
        blank[k] = 1;
        continue;
      }
      blank[k] = 0;
      for (let at = ends[k]; at < end; at += 1) {
        const value = c + weights[2 * at] * (a - c) + weights[2 * at + 1] * (b - c);
        const level = (value - low) * scale;
        // A value that is not a number fails both comparisons, and its colour is that of no entry: empty.
        image[pixels[at]] = level <= 0 ? table[0] : level >= 255 ? table[255] : table[level | 0] * (level === level);
      }
    }
  }
}

/** A canvas on which fields of one mesh are drawn, one after the other. */
export class Painting {
  /** Give the canvas the size of the raster. */
  constructor(canvas, raster) {
    Object.assign(canvas, { width: raster.width, height: raster.height });
    this.raster = raster;
    this.context = canvas.getContext("2d");
    this.image = this.context.createImageData(raster.width, raster.height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.blank = new Uint8Array(raster.ends.length - 1);
  }

  /** Draw the values that begin at `start`, with the 256 colours of a table between `low` and `high`. */
  paint(values, start, table, low, high) {
    if (table !== this.table) this.blank.fill(0);
    this.table = table;
    this.raster.paint(this.pixels, values, start, table, low, high, this.blank);
    this.context.putImageData(this.image, 0, 0);
  }

  /** Draw nothing. */
  clear() {
    this.pixels.fill(0);
    this.blank.fill(0);
    this.context.putImageData(this.image, 0, 0);
  }
}

/** Return the triangle that holds a place, as {corners, weights}; null if there is none, as in a building. */
export function triangleAt(mesh, x, y) {
  for (let k = 0; k < mesh.triangles.length; k += 3) {
    const corners = [mesh.triangles[k], mesh.triangles[k + 1], mesh.triangles[k + 2]];
    const [ax, bx, cx] = corners.map((node) => mesh.x[node] - x);
    const [ay, by, cy] = corners.map((node) => mesh.y[node] - y);
    const parts = [bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay];
    const double = parts[0] + parts[1] + parts[2];
    if (double !== 0 && parts.every((part) => part / double >= -1e-9)) {
      return { corners, weights: parts.map((part) => part / double) };
    }
  }
  return null;
}
