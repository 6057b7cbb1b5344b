// The single data socket of the page. At most one request is in flight, so a slow page requests less often and the
// server never sends unrequested data. A request contains the needs of all open channels; cursor moves in between
// are coalesced.

import { decodeReply } from "./wire.js";
import { InstantChannel, IntervalChannel, ValueChannel } from "./channels.js";

const RETRY = [100, 250, 500, 1000, 2000, 5000];
// The interval in ms at which the client notices that a file was deleted, replaced or has grown.
const IDLE_POLL = 1000;
const LIVE_PERIOD = 33;

function makeChannel(id, spec, accept, { px = () => 0, value = false, instant = false }) {
  if (value) return new ValueChannel(id, spec, accept);
  return instant ? new InstantChannel(id, spec, accept) : new IntervalChannel(id, spec, accept, { px });
}

/**
 * @typedef {object} Request
 * @property {[number, object][]} open
 * @property {number[]} close
 * @property {[number, string, string, number][]} series
 * @property {number[]} instant
 * @property {number} [req]
 * @property {boolean} [live]
 * @property {string} [offset]
 * @property {string} [at]
 * @property {string} [snap]
 */

export class DataClient {
  /**
   * @param {object} options
   * @param {() => WebSocket} options.connect returns a WebSocket or an object like it
   * @param {any} options.time the time store
   * @param {(data: any) => import("./wire.js").Reply} [options.decode]
   * @param {(name: string) => void} [options.onStatus]
   * @param {(reply: import("./wire.js").Reply) => void} [options.onReply]
   */
  constructor({ connect, time, decode = decodeReply, onStatus = () => {}, onReply = () => {} }) {
    this.connect = connect;
    this.time = time;
    this.decode = decode;
    this.onStatus = onStatus;
    this.onReply = onReply;
    /** @type {Map<number, import("./channels.js").Channel>} */
    this.channels = new Map();
    this.nextChannel = 1;
    this.request = 0;
    this.inflight = null;
    this.origin = null;
    this.attempts = 0;
    this.snap = null;
    this.closed = false;
    this.sentAt = -Infinity;
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
    ws.onmessage = (e) => this.receiveReply(e.data);
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

  // Opens a channel. spec: {stream, viz, path?} as named in the server's table of visualizers.
  openChannel(spec, accept, options = {}) {
    const id = this.nextChannel++;
    const channel = makeChannel(id, spec, accept, options);
    this.channels.set(id, channel);
    this.pump();
    return channel;
  }

  // Adds a channel of another kind, which make(id) creates.
  addChannel(make) {
    const channel = make(this.nextChannel++);
    this.channels.set(channel.id, channel);
    this.pump();
    return channel;
  }

  closeChannel(channel) {
    if (!channel || !this.channels.delete(channel.id)) return;
    this.gone = [...(this.gone ?? []), channel.id];
    this.pump();
  }

  setSnap(stream) {
    this.snap = stream;
    this.pump(true);
  }

  // Sets the time offset of the compared recording and requests all of its streams again.
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

  // Requests all streams whose names begin with a prefix again, because their messages have changed.
  forgetStreams(prefix) {
    for (const c of this.channels.values()) {
      if (c.spec?.stream?.startsWith(prefix)) Object.assign(c, { held: null, asking: null, at: null });
    }
    this.pump(true);
  }

  // Sends a request if none is in flight and a channel needs data. Called on every change; cheap when idle.
  pump(force = false) {
    if (this.closed) return;
    if (this.inflight || this.ws?.readyState !== 1) {
      this.again = this.again || force;
      return;
    }
    const s = this.time.get();
    const live = s.mode === "live";
    if (live && this.postponeIfEarly()) return;
    /** @type {Request} */
    const message = { open: [], close: this.gone ?? [], series: [], instant: [] };
    const first = this.origin === null;
    for (const c of this.channels.values()) {
      if (!c.opened) {
        message.open.push([c.id, c.spec]);
        c.opened = true;
      }
      if (!first) c.gatherRequest(message, s, this.origin, live, this.growing);
    }
    const wanted = message.open.length || message.close.length || message.series.length || message.instant.length;
    if (!wanted && !force && !this.again && !first) return;
    this.gone = [];
    this.again = false;
    message.req = ++this.request;
    message.live = live;
    if (this.offset != null) message.offset = this.offset;
    if (!first) message.at = this.toAbsolute(s.cursor);
    if (this.snap && !live && s.mode !== "play") message.snap = this.snap;
    this.sentAt = performance.now();
    this.inflight = { message, sent: this.sentAt, cursor: s.cursor };
    this.ws.send(JSON.stringify(message));
    this.stats.requests++;
  }

  toAbsolute(t) {
    return (this.origin + BigInt(Math.round(t))).toString();
  }

  toRelative(ns) {
    return Number(ns - this.origin);
  }

  // Converts the first and last time of a stream (text from the page's configuration) to page times; returns null
  // before the first reply.
  relativeEnds(ends) {
    if (!ends || this.origin === null) return null;
    const toPageTime = (ns) => (ns == null ? null : this.toRelative(BigInt(ns)));
    return { first: toPageTime(ends.first), last: toPageTime(ends.last) };
  }

  receiveReply(buffer) {
    const asked = this.inflight;
    let reply;
    try {
      reply = this.decode(buffer);
    } catch (error) {
      this.inflight = null;
      this.onStatus("broken");
      console.error(error);
      return;
    }
    this.stats.bytes += buffer.byteLength ?? 0;
    if (asked) this.stats.roundTrip = performance.now() - asked.sent;
    const first = this.origin === null;
    if (first) this.origin = reply.from;
    reply.first = first;
    this.growing = reply.live;
    reply.asked = asked;
    reply.cursor = this.toRelative(reply.time);
    this.answered = reply.cursor;
    this.onReply(reply);
    this.time.dispatch({ type: "data", from: this.toRelative(reply.from), to: this.toRelative(reply.to) });
    for (const f of reply.frames) this.deliverFrame(f);
    // the reply to a request from before the last change of the offset
    if (this.offset != null && asked?.message.offset !== this.offset) this.forgetCompared();
    // Reset only now, since the requested data must have arrived before the next request determines what is missing.
    this.inflight = null;
    this.schedulePump(reply.live);
    this.pump(first);
  }

  // Delivers a frame. An error in one channel must not stop the others.
  deliverFrame(f) {
    try {
      this.channels.get(f.channel)?.receiveFrame(f, this);
    } catch (error) {
      console.error(error);
    }
  }

  // In live mode, requests keep the frame rate whatever else changes; the timer sends the next one.
  postponeIfEarly() {
    const left = LIVE_PERIOD - (performance.now() - this.sentAt);
    if (!(left > 1)) return false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.pump(true), left);
    return true;
  }

  // While the source grows, requests its extent regularly; in live mode at the frame rate.
  schedulePump(growing) {
    clearTimeout(this.timer);
    if (this.closed) return;
    const live = this.time.get().mode === "live";
    const period = live && growing ? LIVE_PERIOD : IDLE_POLL;
    const wait = live && growing ? period - (performance.now() - this.sentAt) : period;
    this.timer = setTimeout(() => this.pump(true), Math.max(wait, 0));
  }
}
