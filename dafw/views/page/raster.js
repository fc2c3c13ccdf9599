// Draws a field that is linear in the triangles of a mesh. For each pixel it is found once which triangle covers it and
// how much each corner counts; a new time then costs two products a pixel. This needs no graphics hardware.

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
    let covered = 0;
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
          if (owner[pixel] < 0) covered += 1;
          owner[pixel] = k;
          first[pixel] = wa;
          second[pixel] = wb;
        }
      }
    }
    this.pixels = new Int32Array(covered);
    this.corners = new Int32Array(3 * covered);
    this.weights = new Float32Array(2 * covered);
    for (let pixel = 0, k = 0; pixel < owner.length; pixel += 1) {
      if (owner[pixel] < 0) continue;
      this.pixels[k] = pixel;
      for (let corner = 0; corner < 3; corner += 1) {
        this.corners[3 * k + corner] = mesh.triangles[3 * owner[pixel] + corner];
      }
      this.weights[2 * k] = first[pixel];
      this.weights[2 * k + 1] = second[pixel];
      k += 1;
    }
  }

  /** Colour `image` (one number a pixel) by the nodes' values, which begin at `start`; missing values stay empty. */
  paint(image, values, start, table, low, high) {
    const { pixels, corners, weights } = this;
    const scale = 255 / (high - low);
    for (let k = 0; k < pixels.length; k += 1) {
      const a = values[start + corners[3 * k]];
      const b = values[start + corners[3 * k + 1]];
      const c = values[start + corners[3 * k + 2]];
      const value = c + weights[2 * k] * (a - c) + weights[2 * k + 1] * (b - c);
      const level = (value - low) * scale;
      // A value that is not a number fails both comparisons, and its colour is that of no entry: empty.
      image[pixels[k]] = level <= 0 ? table[0] : level >= 255 ? table[255] : table[level | 0] * (level === level);
    }
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
