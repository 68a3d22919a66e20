// The connection to the server, which comes back by itself.

const AGAIN_MS = 500;

export class Socket {
  // `on` has functions for what arrives: `state` (bytes), `status`, `drives`, `problem`, `open` (true or false).
  constructor(token, on) {
    this.url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/drive?token=${encodeURIComponent(token)}`;
    this.on = on;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(this.url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => this.on.open(true);
    socket.onmessage = ({ data }) => {
      if (typeof data !== "string") return this.on.state(data);
      const message = JSON.parse(data);
      for (const kind of ["status", "drives", "problem"]) if (kind in message) this.on[kind](message[kind]);
    };
    socket.onclose = () => {
      this.on.open(false);
      setTimeout(() => this.connect(), AGAIN_MS);
    };
    this.socket = socket;
  }

  // An input that cannot be sent at once is dropped: an old input is worse than none.
  send(message) {
    if (this.socket.readyState === WebSocket.OPEN && this.socket.bufferedAmount < 4096) this.socket.send(JSON.stringify(message));
  }

  input(name, data) {
    this.send({ input: name, at: performance.now(), data });
  }
}
