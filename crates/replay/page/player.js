// The clock of a replay. It draws only when something has changed.

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

  ask() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.asked = false;
    if (this.playing) {
      const passed = this.before === null ? 0 : Math.min((now - this.before) / 1000, 0.25);
      this.before = now;
      this.step += (passed * this.speed) / this.track.dt;
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
