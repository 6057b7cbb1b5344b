// Channels of binary frames on one WebSocket, with credits: the server sends no more than was asked for.
//
//   const data = new DataSocket("/live/data");
//   const channel = data.open({ name: "a" }, { credits: 2, onFrame(frame) { draw(new Float32Array(frame.buffer, 16)); } });
//   channel.send({ ... });  channel.close();
//
// A frame: { kind, dropped, time (BigInt nanoseconds), buffer, offset: 16 }. When onFrame returns (or the promise that it
// returns is settled) one credit goes back. After a lost connection channels are opened again with what `params` is then.

const HEADER = 16;
const PING_MS = 30_000;
const BACKOFF_MS = [50, 200, 500, 1000, 2000, 5000];

export class DataSocket {
  constructor(path, { WebSocket: Socket = globalThis.WebSocket, onState = () => {} } = {}) {
    this.url = new URL(path, globalThis.location?.href ?? "http://localhost/");
    this.url.protocol = this.url.protocol.replace("http", "ws");
    this.Socket = Socket;
    this.onState = onState;
    this.channels = new Map();
    this.next = 1;
    this.tries = 0;
    this.connect();
  }

  connect() {
    const socket = new this.Socket(this.url.href);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.tries = 0;
      this.onState("open");
      for (const channel of this.channels.values()) channel.reopen();
      this.ping = setInterval(() => this.push({ op: "ping" }), PING_MS);
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.text(JSON.parse(data)) : this.binary(data));
    socket.onclose = () => {
      clearInterval(this.ping);
      if (this.closed) return;
      this.onState("closed");
      const wait = BACKOFF_MS[Math.min(this.tries++, BACKOFF_MS.length - 1)];
      this.retry = setTimeout(() => this.connect(), wait);
    };
  }

  open(params, options = {}) {
    const channel = new Channel(this, this.next++, params, options);
    this.channels.set(channel.id, channel);
    if (this.socket.readyState === 1) channel.reopen();
    return channel;
  }

  push(message) {
    if (this.socket.readyState === 1) this.socket.send(JSON.stringify(message));
  }

  close() {
    this.closed = true;
    clearInterval(this.ping);
    clearTimeout(this.retry);
    this.channels.clear();
    this.socket.close();
  }

  text(message) {
    const channel = this.channels.get(message.ch);
    if (!channel) return;
    if (message.op === "opened") channel.options.onOpen?.();
    if (message.op === "reply") channel.options.onReply?.(message.data);
    if (message.op === "error") channel.options.onError?.(message.reason);
    if (message.op === "closed" || message.op === "error") {
      this.channels.delete(message.ch);
      channel.options.onClose?.();
    }
  }

  binary(buffer) {
    const view = new DataView(buffer);
    if (buffer.byteLength < HEADER || view.getUint8(0) !== 1) return;
    this.channels.get(view.getUint32(4, true))?.frame({
      kind: view.getUint8(1),
      dropped: view.getUint16(2, true),
      time: view.getBigInt64(8, true),
      buffer,
      offset: HEADER,
    });
  }
}

class Channel {
  constructor(owner, id, params, options) {
    Object.assign(this, { owner, id, params, options });
  }

  reopen() {
    this.owner.push({ op: "open", ch: this.id, params: this.params, credits: this.options.credits ?? 2 });
  }

  // A frame that cannot be drawn must not stop the channel.
  async frame(frame) {
    try {
      await this.options.onFrame?.(frame);
    } catch (error) {
      console.error(error);
    }
    this.owner.push({ op: "credit", ch: this.id, n: 1 });
  }

  send(params) {
    this.owner.push({ op: "msg", ch: this.id, params });
  }

  close() {
    this.owner.channels.delete(this.id);
    this.owner.push({ op: "close", ch: this.id });
  }
}
