// The conversation with the view: every answer is asked for, so that a slow page skips frames and queues none.

const LITTLE_ENDIAN = true;
const ARRAYS = {uint8: Uint8Array, uint16: Uint16Array, int32: Int32Array, float32: Float32Array, float64: Float64Array};

export class Link {
  constructor(token) {
    this.token = token;
    this.handlers = {};
    this.pause_ms = 250;
  }

  on(kind, handler) { this.handlers[kind] = handler; }

  open() {
    const address = new URL(`/stream?token=${encodeURIComponent(this.token)}`, location.href);
    address.protocol = address.protocol.replace("http", "ws");
    this.socket = new WebSocket(address);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.pause_ms = 250; this.handlers.open(); };
    this.socket.onmessage = event => this.receive(event.data);
    this.socket.onclose = event => {
      this.handlers.close(event.reason);
      setTimeout(() => this.open(), this.pause_ms);
      this.pause_ms = Math.min(5000, 2 * this.pause_ms);
    };
  }

  ask(kind, fields = {}) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify({ask: kind, ...fields}));
  }

  receive(data) {
    if (typeof data === "string") {
      const told = JSON.parse(data);
      this.handlers[told.kind](told);
      return;
    }
    const size = new DataView(data).getUint32(0, LITTLE_ENDIAN);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    const values = new ARRAYS[head.dtype](data, 4 + size, head.width * head.height);
    this.handlers[head.kind](head, values);
  }
}
