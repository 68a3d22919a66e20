// The connection to the server, which comes back by itself.

const AGAIN_MS = 500;
// Codes with which the server says that it will not come back, see `pages.rs`.
const ENDED = 1001;
const TOO_MANY = 4000;
// A server that cannot be reached for this long has probably ended.
const LOST_MS = 3000;

export class Socket {
  // `on` has functions for what arrives: `state` (bytes), `status`, `drives`, `problem`, and `open` (true, or false and why not).
  constructor(token, on) {
    this.url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/drive?token=${encodeURIComponent(token)}`;
    this.on = on;
    this.lost = null;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.lost = null;
      this.on.open(true);
    };
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") return this.on.state(data);
      const message = JSON.parse(data);
      for (const kind of ["status", "drives", "problem"]) if (kind in message) this.on[kind](message[kind]);
    };
    socket.onclose = ({ code }) => {
      this.on.open(false, this.reason(code));
      if (code !== TOO_MANY) setTimeout(() => this.connect(), AGAIN_MS);
    };
    this.socket = socket;
  }

  reason(code) {
    if (code === TOO_MANY) return "Too many pages: reload this one to drive";
    // It may be started again at the same port, but with another token.
    if (code === ENDED) this.lost = -LOST_MS;
    const now = performance.now();
    this.lost ??= now;
    return now - this.lost >= LOST_MS ? "The program has ended" : "No connection: the robot stands";
  }

  // An input that cannot be sent at once is dropped: an old input is worse than none.
  send(message) {
    if (this.socket.readyState === WebSocket.OPEN && this.socket.bufferedAmount < 4096) this.socket.send(JSON.stringify(message));
  }

  input(name, data) {
    this.send({ input: name, at: performance.now(), data });
  }
}
