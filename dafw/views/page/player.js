// The time that the page shows: one row of the run. Views ask to be told when it changes.

const READABLE = 100; // milliseconds that a number stays while the page plays: who would read sixty of them a second?

/**
 * The row that is shown, and playing. Views are drawn at most once a frame of the screen. They change their texts only
 * if the player is `telling`: while it plays ten times a second, otherwise always. Laying out texts takes longer than
 * drawing the maps.
 */
export class Player {
  constructor(count) {
    this.count = count;
    this.row = 0;
    this.speed = 10;
    this.playing = false;
    this.listeners = [];
    this.states = [];
    this.frames = 0;
    this.waiting = false;
    this.telling = true;
    this.told = 0;
  }

  /** Call a function with the row whenever it changes. */
  onRow(listener) {
    this.listeners.push(listener);
  }

  /** Call a function when playing begins and ends. */
  onState(listener) {
    this.states.push(listener);
  }

  /** Show a row. */
  go(row) {
    const wanted = Math.min(this.count - 1, Math.max(0, Math.round(row)));
    if (wanted === this.row) return;
    this.row = wanted;
    this.redraw();
  }

  /** Take a new number of rows; if the last one was shown, the new last one is. */
  extend(count) {
    if (this.row === this.count - 1) this.row = count - 1;
    this.count = count;
    this.row = Math.min(this.row, count - 1);
    this.redraw();
  }

  /** Draw the row that is shown anew, in the next frame. */
  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    this.frames += 1;
    const now = performance.now();
    this.telling = !this.playing || now - this.told >= READABLE;
    if (this.telling) this.told = now;
    for (const listener of this.listeners) listener(this.row);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Play from the row that is shown; from the start if it is the last. */
  play() {
    if (this.playing || this.count < 2) return;
    if (this.row === this.count - 1) this.go(0);
    this.playing = true;
    for (const listener of this.states) listener(true);
    let before = null;
    let owed = 0;
    const step = (now) => {
      if (!this.playing) return;
      owed += before === null ? 0 : ((now - before) / 1000) * this.speed;
      before = now;
      // A page that was hidden for a while goes on where it was.
      const rows = Math.min(Math.floor(owed), Math.max(1, this.speed));
      if (rows > 0) {
        owed = Math.min(owed - rows, 1);
        this.go(this.row + rows);
      }
      if (this.row === this.count - 1) this.pause();
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() {
    if (!this.playing) return;
    this.playing = false;
    for (const listener of this.states) listener(false);
    this.redraw(); // with all texts
  }
}
