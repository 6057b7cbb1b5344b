// The page's one data socket. At most one request is in flight: a slow page asks less often, and the server never
// sends what was not asked for. A request gathers what every open channel wants now; cursor moves in between coalesce.

import { decode } from "./wire.js";
import { InstantChannel, IntervalChannel, ValueChannel } from "./channels.js";

const RETRY = [100, 250, 500, 1000, 2000, 5000];
// A file deleted, replaced or growing is noticed after so long, in ms.
const IDLE_POLL = 1000;
const LIVE_PERIOD = 33;

export class DataClient {
  // connect() -> a WebSocket-like object; time: the time store; onStatus(name), onReply(reply)
  constructor({ connect, time, onStatus = () => {}, onReply = () => {} }) {
    Object.assign(this, { connect, time, onStatus, onReply });
    this.channels = new Map();
    this.nextChannel = 1;
    this.request = 0;
    this.inflight = null;
    this.origin = null;
    this.attempts = 0;
    this.snap = null;
    this.closed = false;
    this.stats = { requests: 0, bytes: 0, roundTrip: 0 };
    this.growing = false;
    this.answered = null;
  }

  start() {
    if (this.closed) return;
    const ws = this.connect();
    ws.binaryType = "arraybuffer";
    this.ws = ws;
    ws.onopen = () => {
      this.attempts = 0;
      this.inflight = null;
      for (const c of this.channels.values()) c.reopen();
      this.onStatus("open");
      this.pump();
    };
    ws.onmessage = (e) => this.receive(e.data);
    ws.onclose = () => {
      if (this.ws !== ws || this.closed) return;
      this.inflight = null;
      this.onStatus("closed");
      const wait = RETRY[Math.min(this.attempts++, RETRY.length - 1)];
      this.retry = setTimeout(() => this.start(), wait);
    };
  }

  stop() {
    this.closed = true;
    clearTimeout(this.retry);
    clearTimeout(this.timer);
    this.ws?.close();
  }

  // spec: {stream, viz, path?} as the server's table of visualizers names it
  open(spec, accept, options = {}) {
    const id = this.nextChannel++;
    const Kind = options.value ? ValueChannel : options.instant ? InstantChannel : IntervalChannel;
    const channel = new Kind(id, spec, accept, options);
    this.channels.set(id, channel);
    this.pump();
    return channel;
  }

  // A channel of another kind: make(id) gives it.
  add(make) {
    const channel = make(this.nextChannel++);
    this.channels.set(channel.id, channel);
    this.pump();
    return channel;
  }

  close(channel) {
    if (!channel || !this.channels.delete(channel.id)) return;
    this.gone = [...(this.gone ?? []), channel.id];
    this.pump();
  }

  setSnap(stream) {
    this.snap = stream;
    this.pump(true);
  }

  // Shifts the second of two recordings that are compared: of its streams all is asked for again.
  setOffset(offset) {
    if (offset === this.offset) return;
    this.offset = offset;
    this.forgetCompared();
    this.pump(true);
  }

  forgetCompared() {
    for (const c of this.channels.values()) {
      if (c.spec?.stream?.includes("Compared.")) Object.assign(c, { held: null, asking: null, at: null });
    }
  }

  // Sends one request when none is in flight and something is wanted. Called on every change; cheap when idle.
  pump(force = false) {
    if (this.closed) return;
    if (this.inflight || this.ws?.readyState !== 1) {
      this.again = this.again || force;
      return;
    }
    const s = this.time.get();
    const live = s.mode === "live";
    if (live && this.early()) return;
    const message = { open: [], close: this.gone ?? [], series: [], instant: [] };
    const first = this.origin === null;
    for (const c of this.channels.values()) {
      if (!c.opened) {
        message.open.push([c.id, c.spec]);
        c.opened = true;
      }
      if (!first) c.gather(message, s, this.origin, live, this.growing);
    }
    const wanted = message.open.length || message.close.length || message.series.length || message.instant.length;
    if (!wanted && !force && !this.again && !first) return;
    this.gone = [];
    this.again = false;
    message.req = ++this.request;
    message.live = live;
    if (this.offset != null) message.offset = this.offset;
    if (!first) message.at = this.abs(s.cursor);
    if (this.snap && !live && s.mode !== "play") message.snap = this.snap;
    this.sentAt = performance.now();
    this.inflight = { message, sent: this.sentAt, cursor: s.cursor };
    this.ws.send(JSON.stringify(message));
    this.stats.requests++;
  }

  abs(t) {
    return (this.origin + BigInt(Math.round(t))).toString();
  }

  rel(ns) {
    return Number(ns - this.origin);
  }

  // Where a stream begins and ends, told as text by the page's configuration; null before the first answer.
  ends(told) {
    if (!told || this.origin === null) return null;
    const at = (ns) => (ns == null ? null : this.rel(BigInt(ns)));
    return { first: at(told.first), last: at(told.last) };
  }

  receive(buffer) {
    const asked = this.inflight;
    let reply;
    try {
      reply = decode(buffer);
    } catch (error) {
      this.inflight = null;
      this.onStatus("broken");
      console.error(error);
      return;
    }
    this.stats.bytes += buffer.byteLength;
    if (asked) this.stats.roundTrip = performance.now() - asked.sent;
    const first = this.origin === null;
    if (first) this.origin = reply.from;
    reply.first = first;
    this.growing = reply.live;
    reply.asked = asked;
    reply.cursor = this.rel(reply.time);
    this.answered = reply.cursor;
    this.onReply(reply);
    this.time.dispatch({ type: "data", from: this.rel(reply.from), to: this.rel(reply.to) });
    for (const f of reply.frames) this.deliver(f);
    // an answer to a request from before the last shift
    if (this.offset != null && asked?.message.offset !== this.offset) this.forgetCompared();
    // Only now: what was asked for must have arrived before the next request says what is missing.
    this.inflight = null;
    this.schedule(reply.live);
    this.pump(first);
  }

  // A channel that cannot take its data must not keep the others waiting.
  deliver(f) {
    try {
      this.channels.get(f.channel)?.receive(f, this);
    } catch (error) {
      console.error(error);
    }
  }

  // Live, requests keep the rate of pictures whatever moves meanwhile; the timer sends the next.
  early() {
    const left = LIVE_PERIOD - (performance.now() - this.sentAt);
    if (!(left > 1)) return false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.pump(true), left);
    return true;
  }

  // While the source grows, ask for its newest extents now and then; in live mode at the picture rate.
  schedule(growing) {
    clearTimeout(this.timer);
    if (this.closed) return;
    const live = this.time.get().mode === "live";
    const period = live && growing ? LIVE_PERIOD : IDLE_POLL;
    const wait = live && growing ? period - (performance.now() - this.sentAt) : period;
    this.timer = setTimeout(() => this.pump(true), Math.max(wait, 0));
  }
}
