// The clock of a replay. It draws only when something has changed.

// A frame that takes longer slows the replay down, s.
const LONGEST_FRAME = 1;

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

export class Player {
  constructor(track, draw) {
    this.track = track;
    this.draw = draw;
    this.step = track.first;
    this.speed = 1;
    this.playing = false;
    this.asked = false;
    this.before = null;
    // Frames of the last second: when each was drawn, and the steps that it moved on.
    this.recent = [];
    this.listeners = [];
  }

  // Calls back when it starts, stops, or changes its speed.
  onChange(listener) {
    this.listeners.push(listener);
  }

  changed() {
    this.listeners.forEach((listener) => listener());
  }

  toggle() {
    if (!this.playing && this.step >= this.track.last) this.step = this.track.first;
    this.playing = !this.playing;
    this.before = null;
    this.recent = [];
    this.changed();
    this.ask();
  }

  pause() {
    if (this.playing) this.toggle();
  }

  seek(step) {
    this.step = Math.min(Math.max(step, this.track.first), this.track.last);
    this.ask();
  }

  // By seconds of simulated time.
  move(seconds) {
    this.seek(this.step + seconds / this.track.dt);
  }

  faster(by) {
    const index = SPEEDS.indexOf(this.speed);
    this.setSpeed(SPEEDS[Math.min(Math.max(index + by, 0), SPEEDS.length - 1)]);
  }

  setSpeed(speed) {
    this.speed = SPEEDS.includes(speed) ? speed : 1;
    this.changed();
  }

  // Shown while it plays: times real time, and frames a second. None until a few frames are drawn.
  rate() {
    const last = this.recent.length - 1;
    const span = last < 2 || !this.playing ? 0 : (this.recent[last].now - this.recent[0].now) / 1000;
    if (span < 0.3) return null;
    const moved = this.recent.slice(1).reduce((sum, frame) => sum + frame.moved, 0);
    return { speed: moved / span, frames: last / span };
  }

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.asked = false;
    if (this.playing) {
      // A slow machine skips rows and keeps the time; a page that was hidden goes on where it was.
      const passed = this.before === null ? 0 : Math.min((now - this.before) / 1000, LONGEST_FRAME);
      this.before = now;
      this.step += (passed * this.speed) / this.track.dt;
      this.recent.push({ now, moved: passed * this.speed });
      while (now - this.recent[0].now > 1000) this.recent.shift();
      if (this.step >= this.track.last) {
        this.step = this.track.last;
        this.playing = false;
        this.changed();
      }
    }
    this.draw(this.step);
    if (this.playing) this.ask();
  }
}
