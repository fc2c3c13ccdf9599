// The map on which things are placed: mesh, buildings, what was changed, and over it release, drones and winds.

import { Overlay } from "./overlay.js";

const byId = (id) => document.getElementById(id);

/** Draws the site once, and the places anew whenever one moves. */
export class GroundMap {
  constructor(data, mesh, theme) {
    Object.assign(this, { data, mesh, theme });
    this.box = byId("map");
    this.under = byId("under");
    this.onPick = () => {};
    const { extent } = data.map;
    const ratio = (extent[1] - extent[0]) / (extent[3] - extent[2]);
    this.box.style.aspectRatio = String(ratio);
    this.box.style.setProperty("--ratio", String(ratio));
    this.overlay = new Overlay(byId("over"), data, extent, "", byId("walls"));
    this.edges = edgesOf(mesh.triangles);
    this.box.addEventListener("click", (event) => this.pick(event));
    new ResizeObserver(() => this.resize()).observe(this.box);
    theme.onChange(() => this.resize());
  }

  pick(event) {
    const [left, right, bottom, top] = this.data.map.extent;
    const box = this.box.getBoundingClientRect();
    const across = (event.clientX - box.left - this.box.clientLeft) / this.box.clientWidth;
    const down = (event.clientY - box.top - this.box.clientTop) / this.box.clientHeight;
    this.onPick(left + across * (right - left), top - down * (top - bottom));
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.box;
    if (!width || !height) return;
    const ratio = Math.min(devicePixelRatio || 1, 3);
    this.under.width = Math.round(width * ratio);
    this.under.height = Math.round(height * ratio);
    this.under.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
    this.overlay.resize(width, height, ratio, this.theme.colours);
    this.drawUnder();
    if (this.last) this.draw(...this.last);
  }

  /** Draw mesh, rim and what was changed. */
  drawUnder() {
    const context = this.under.getContext("2d");
    const { overlay } = this;
    const { colours } = this.theme;
    context.clearRect(0, 0, overlay.width, overlay.height);
    if (byId("mesh").checked) this.drawMesh(context, colours);
    overlay.drawWalls(colours);
    const [x0, y0, x1, y1] = this.data.rim;
    context.strokeStyle = colours.soft;
    context.lineWidth = 1;
    context.setLineDash([6, 4]);
    const corner = overlay.place(x0, y1);
    const opposite = overlay.place(x1, y0);
    context.strokeRect(...corner, opposite[0] - corner[0], opposite[1] - corner[1]);
    context.setLineDash([]);
    if (byId("changes").checked) this.drawChanges();
  }

  drawMesh(context, colours) {
    const { x, y } = this.mesh;
    context.beginPath();
    for (let k = 0; k < this.edges.length; k += 2) {
      context.moveTo(...this.overlay.place(x[this.edges[k]], y[this.edges[k]]));
      context.lineTo(...this.overlay.place(x[this.edges[k + 1]], y[this.edges[k + 1]]));
    }
    context.strokeStyle = colours.edge;
    context.lineWidth = 0.6;
    context.stroke();
  }

  /** Draw over the buildings what the file does not have, or has and the site does not. */
  drawChanges() {
    const context = byId("walls").getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const { added, removed, crossing } = this.data.changes;
    for (const [rings, name] of [[added, "--added"], [removed, "--removed"]]) {
      context.fillStyle = style.getPropertyValue(name).trim();
      for (const ring of rings) {
        this.trace(context, ring);
        context.fill();
      }
    }
    context.strokeStyle = style.getPropertyValue("--revised").trim();
    context.lineWidth = 1.8;
    for (const ring of crossing) {
      this.trace(context, ring);
      context.stroke();
    }
  }

  trace(context, ring) {
    context.beginPath();
    for (const [x, y] of ring) context.lineTo(...this.overlay.place(x, y));
    context.closePath();
  }

  /** Draw everything that is placed, what is chosen with a ring, and a cross where something was refused. */
  draw(spots, chosen, refused = null) {
    this.last = [spots, chosen, refused];
    const { overlay } = this;
    const { colours } = this.theme;
    const { context } = overlay;
    if (!overlay.width) return;
    context.clearRect(0, 0, overlay.width, overlay.height);
    const [release, ...drones] = spots;
    const [left, right] = this.data.map.extent;
    const radius = (this.data.radius / (right - left)) * overlay.width;
    context.globalAlpha = 0.4;
    overlay.dot(overlay.place(release.x, release.y), radius, "#ffd92f", "#ffd92f");
    context.globalAlpha = 1;
    overlay.drawLandmark({ name: "release", x: release.x, y: release.y }, colours);
    for (const { x, y } of this.data.further) overlay.drawLandmark({ name: "release", x, y }, colours);
    for (const { x, y } of drones) overlay.drawVehicle({ x: [x], y: [y] }, 0, colours);
    this.ring(overlay.place(spots[chosen].x, spots[chosen].y), colours);
    for (const { role, speed, direction } of this.data.winds) {
      overlay.wind = { speed: [speed], direction: [direction] };
      overlay.drawWind(0, { ...colours, accent: colours[role] });
    }
    if (refused) this.cross(overlay.place(refused.x, refused.y), colours);
  }

  ring(at, colours) {
    const { context } = this.overlay;
    for (const [style, width] of [[colours.halo, 4.5], [colours.accent, 2]]) {
      context.beginPath();
      context.arc(...at, 12, 0, 2 * Math.PI);
      context.strokeStyle = style;
      context.lineWidth = width;
      context.stroke();
    }
  }

  cross([x, y], colours) {
    const { context } = this.overlay;
    for (const [style, width] of [[colours.halo, 6], [colours.revised, 3]]) {
      context.beginPath();
      context.moveTo(x - 7, y - 7);
      context.lineTo(x + 7, y + 7);
      context.moveTo(x - 7, y + 7);
      context.lineTo(x + 7, y - 7);
      context.strokeStyle = style;
      context.lineWidth = width;
      context.lineCap = "round";
      context.stroke();
    }
  }
}

/** Return every edge of some triangles once, as pairs of nodes. */
function edgesOf(triangles) {
  const seen = new Set();
  const edges = [];
  for (let k = 0; k < triangles.length; k += 3) {
    for (let corner = 0; corner < 3; corner += 1) {
      const [a, b] = [triangles[k + corner], triangles[k + ((corner + 1) % 3)]].sort((one, other) => one - other);
      const key = a * 4294967296 + b;
      if (!seen.has(key)) {
        seen.add(key);
        edges.push(a, b);
      }
    }
  }
  return edges;
}
