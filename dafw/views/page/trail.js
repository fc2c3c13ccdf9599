// The readings that were taken before the time that is shown, on a canvas of their own: a new row adds its dots to those
// that are there, and only a step back draws all of them anew.

const MOST = 2000; // readings that are drawn, the latest ones

/** The dots of the readings up to a row. */
export class Trail {
  constructor() {
    this.canvas = document.createElement("canvas");
    this.context = this.canvas.getContext("2d");
    this.forget();
  }

  /** Draw everything anew the next time. */
  forget() {
    this.begin = 0;
    this.end = 0;
    this.stale = true;
  }

  /** Take the size of another canvas, with `ratio` of its pixels to one of CSS. */
  resize({ width, height }, ratio) {
    Object.assign(this.canvas, { width, height });
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ratio = ratio;
    this.forget();
  }

  /** Let `dot(context, k)` draw the readings before number `end`, as far as they are not drawn yet. */
  draw(end, dot) {
    const begin = Math.max(0, end - MOST);
    if (this.stale || end < this.end || begin !== this.begin) {
      this.context.clearRect(0, 0, this.canvas.width / this.ratio, this.canvas.height / this.ratio);
      this.end = begin;
    }
    for (let k = this.end; k < end; k += 1) dot(this.context, k);
    Object.assign(this, { begin, end, stale: false });
  }
}
