// A channel is what one panel shows of one stream: windows over time, or the message at the cursor. The client sends
// its requests and delivers the frames.

import { KIND } from "./frames.js";
import { planWindow } from "./window.js";
import { Series, keepLines } from "./series.js";
import { keepMarks, keepSegments } from "./lanes.js";

export class Channel {
  constructor(id, spec, accept) {
    this.id = id;
    this.spec = spec;
    this.accept = accept;
    this.opened = false;
    this.error = null;
  }

  reopen() {
    this.opened = false;
  }

  // Adds what the channel needs to a request.
  gatherRequest(_message, _time, _origin, _live, _growing) {}

  receiveFrame(_frame, _client) {}
}

export class IntervalChannel extends Channel {
  constructor(id, spec, accept, { px }) {
    super(id, spec, accept);
    this.px = px;
    /** @type {{from: number, to: number, bin?: number, head: number, newest?: number} | null} the held window */
    this.held = null;
    /** @type {{from: number, to: number, bin: number, append: boolean} | null} the requested window */
    this.asking = null;
    this.series = new Series();
    this.lines = new Map();
    this.marks = null;
    this.segments = null;
    this.sounds = null;
    this.version = 0;
  }

  reopen() {
    super.reopen();
    this.held = null;
    this.asking = null;
  }

  gatherRequest(message, s, origin, live) {
    const px = this.px();
    if (px <= 0) return;
    const w = planWindow(this.held, s.view, px, s.data, live);
    this.asking = w;
    if (!w) return;
    const toAbsolute = (t) => (origin + BigInt(Math.round(t))).toString();
    message.series.push([this.id, toAbsolute(w.from), toAbsolute(w.to), w.bin]);
  }

  receiveFrame(f, client) {
    const w = this.asking;
    this.asking = null;
    this.error = f.kind === KIND.error ? f.message : null;
    if (w && !this.error) {
      this.storeFrame(f, client.toRelative(f.time), w);
      const head = client.time.get().data[1];
      this.held = {
        from: w.append && this.held ? this.held.from : w.from,
        to: w.to,
        bin: w.bin,
        head,
        newest: this.newestTime(f, client),
      };
    } else if (this.error) {
      this.held = { from: -Infinity, to: Infinity, bin: w?.bin, head: Infinity };
    }
    this.version++;
    this.accept(this);
  }

  // Returns the time of the newest held message, or -Infinity if there is none.
  newestTime(f, client) {
    if (f.kind === KIND.segments) return f.count ? client.toRelative(f.time) + f.step : -Infinity;
    if (f.kind === KIND.marks) return this.marks.t[this.marks.t.length - 1] ?? -Infinity;
    const held = f.kind === KIND.lines ? [...this.lines.values()] : [this.series];
    return Math.max(-Infinity, ...held.filter((s) => s.length).map((s) => s.t[s.length - 1]));
  }

  // Stores a frame: a new window replaces the held one, an appended window extends it.
  storeFrame(f, base, w) {
    const from = w.append ? w.from : -Infinity;
    const forget = w.from - 4 * (w.to - w.from);
    if (f.kind === KIND.series) {
      this.series.putFrame(f, base, from, w.bin);
      if (w.append) this.series.trimBefore(forget);
    } else if (f.kind === KIND.lines) {
      this.lines = keepLines(w.append ? this.lines : new Map(), f.lines, base, from, forget, w.bin);
      // the number of lines that the server omitted
      this.more = f.step;
    }
    if (f.kind === KIND.marks) this.marks = keepMarks(w.append ? this.marks : null, f, base, w.from);
    else if (f.kind === KIND.sounds) this.sounds = { ...f, base, from: w.append ? w.from : -Infinity };
    else if (f.kind === KIND.segments)
      this.segments = keepSegments(w.append ? this.segments : null, f.value, base, w.from);
  }
}

export class InstantChannel extends Channel {
  constructor(id, spec, accept) {
    super(id, spec, accept);
    this.at = null;
    this.head = null;
    this.kept = new Map();
  }

  reopen() {
    super.reopen();
    this.at = null;
    // the server then also forgets which meshes it has sent
    this.kept = new Map();
  }

  // While the source grows, a message before the cursor may still arrive, so the channel requests it again.
  gatherRequest(message, s, _origin, live, growing) {
    const head = growing ? s.data[1] : this.head;
    if (!live && this.at === s.cursor && this.head === head) return;
    this.at = s.cursor;
    this.head = head;
    message.instant.push(this.id);
  }

  receiveFrame(f, client) {
    this.error = f.kind === KIND.error ? f.message : null;
    if (f.kind === KIND.same) return;
    f.at = client.toRelative(f.time);
    if (f.kind === KIND.scene) this.restoreMeshes(f);
    this.accept(f, this);
  }

  // Restores meshes, which are sent only once: meshes to be kept are copied out of the reply, and inserted where
  // later frames only name them.
  restoreMeshes(f) {
    for (const item of f.items) {
      if (item.keep) {
        const whole = { count: item.count, position: item.position.slice(), index: item.index.slice() };
        this.kept.set(item.keep, whole);
        Object.assign(item, whole);
      } else if (item.held) Object.assign(item, this.kept.get(item.held) ?? { lost: true });
    }
    if (!f.items.some((item) => item.lost)) return;
    f.items = f.items.filter((item) => !item.lost);
    this.reopen();
  }
}

// The exact value of a plotted stream at the cursor, as sent by the server. It does not depend on the drawn rows.
export class ValueChannel extends InstantChannel {
  constructor(id, spec, accept) {
    super(id, spec, accept);
    this.reading = null;
    this.answered = null;
  }

  reopen() {
    super.reopen();
    this.answered = null;
  }

  receiveFrame(f, client) {
    this.answered = client.answered;
    this.error = f.kind === KIND.error ? f.message : null;
    if (f.kind !== KIND.same) this.reading = this.error || f.kind === KIND.none ? null : decodeValue(f, client);
    this.accept(this);
  }

  // Returns true if the value belongs to this cursor and not to an earlier one.
  holdsAt(cursor) {
    return this.answered === Math.round(cursor);
  }
}

// Returns {at, values}: the time of the message, and a Map from name to exact text. A spectrogram gets {at, values,
// rate, samples} without values.
function decodeValue(f, client) {
  const at = client.toRelative(f.time);
  // copied, so that the buffer of the whole reply can be freed
  if (f.kind === KIND.sounds) return { at, values: new Map(), rate: f.rate, samples: f.samples.slice() };
  return { at, values: new Map(f.value.values) };
}
