// The data of an exported page, which answers the requests of the page's data client in place of a server.

import { KIND } from "../data/frames.js";
import { decodeReply } from "../data/wire.js";
import { cutSegments, cutWindow, findMessage, joinColumns, joinSegments } from "./windows.js";

const HEADER_BYTES = 16;

/**
 * @typedef {object} Entry what the page holds for one drawn stream
 * @property {string} stream
 * @property {string} viz
 * @property {string} path
 * @property {Record<string, any>} props
 * @property {number[]} [windows] frames of consecutive parts
 * @property {number[]} [instants] frames of messages, in order
 * @property {string[]} [times] the times of these messages in ns
 * @property {any} [joined]
 * @property {number[]} [at]
 */

/**
 * Unpacks the base64 text of gzipped bytes.
 * @param {string} text
 * @returns {Promise<ArrayBuffer>}
 */
export function unpack(text) {
  const packed = atob(text.trim());
  const bytes = new Uint8Array(packed.length);
  for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

export class PageData {
  /** @param {ArrayBuffer} buffer the sizes of the parts, a list of contents as JSON, a reply with all frames, sounds */
  constructor(buffer) {
    const view = new DataView(buffer);
    const [listBytes, replyBytes] = [view.getUint32(0, true), view.getUint32(8, true)];
    const listed = new Uint8Array(buffer, HEADER_BYTES, listBytes);
    this.list = JSON.parse(new TextDecoder().decode(listed));
    const start = align(HEADER_BYTES + listBytes);
    const reply = decodeReply(buffer.slice(start, start + replyBytes));
    this.frames = reply.frames;
    this.from = reply.from;
    this.to = reply.to;
    this.sounds = new Int16Array(buffer.slice(align(start + replyBytes)));
    /** @type {Map<string, Entry>} */
    this.entries = new Map();
    for (const entry of this.list.entries) this.entries.set(entryKey(entry), entry);
    /** @type {Map<number, Entry | undefined>} the entries of the page's channels */
    this.channels = new Map();
    /** @type {Map<number, number>} what each channel showed last */
    this.shown = new Map();
  }

  /** @param {any} request */
  answer(request) {
    for (const [id, spec] of request.open) {
      this.channels.set(id, this.findEntry(spec));
      this.shown.delete(id);
    }
    for (const id of request.close) this.channels.delete(id);
    const at = request.at === undefined ? this.from : BigInt(request.at);
    const windows = request.series.map(([id, from, to, bin]) => {
      const range = /** @type {[number, number]} */ ([from, to].map((t) => this.toRelative(BigInt(t))));
      return this.windowFrame(id, ...range, bin);
    });
    const instants = request.instant.map((id) => this.instantFrame(id, this.toRelative(at)));
    return {
      request: request.req,
      live: false,
      gone: false,
      replaced: false,
      from: this.from,
      to: this.to,
      version: 1,
      time: at,
      frames: [...windows, ...instants],
    };
  }

  // The page has 3D objects as a whole, not the visible part of large clouds.
  findEntry(spec) {
    const found = this.entries.get(entryKey(spec));
    if (found || spec.props?.within) return found;
    return this.list.entries.find((e) => e.stream === spec.stream && e.viz === spec.viz && e.path === spec.path);
  }

  toRelative(ns) {
    return Number(ns - this.from);
  }

  // The base of frames is the page's start, to which their times are relative.
  makeFrame(channel, kind, more) {
    return { channel, kind, flags: 0, step: 0, time: this.from, sampled: false, together: false, ...more };
  }

  missingFrame(channel) {
    return this.makeFrame(channel, KIND.error, { message: "this is not part of the exported page" });
  }

  windowFrame(channel, from, to, bin) {
    const entry = this.channels.get(channel);
    if (!entry?.windows) return this.missingFrame(channel);
    const { kind, ...joined } = this.joinParts(entry);
    if (kind === KIND.series) return this.makeFrame(channel, kind, cutWindow(joined.columns, from, to, bin));
    if (kind === KIND.lines) {
      const lines = joined.lines.map(({ name, columns }) => ({ name, ...cutWindow(columns, from, to, bin) }));
      return this.makeFrame(channel, kind, { lines, step: joined.more, raw: lines.every((l) => l.raw) });
    }
    if (kind === KIND.segments) {
      const value = cutSegments(joined.segments, from, to, bin);
      return this.makeFrame(channel, kind, { value, count: 0 });
    }
    if (kind === KIND.marks) return this.makeFrame(channel, kind, joined.marks);
    return { ...joined.frame, channel };
  }

  // Joins the parts of a stream when it is drawn for the first time.
  joinParts(entry) {
    entry.joined ??= this.joinFrames((entry.windows ?? []).map((i) => this.frames[i]));
    return entry.joined;
  }

  joinFrames(frames) {
    const { kind } = frames[0];
    const parts = frames.filter((f) => f.kind === kind).map((f) => ({ base: this.toRelative(f.time), frame: f }));
    const raw = frames.every((f) => f.raw);
    if (kind === KIND.series) {
      const columns = joinColumns(parts.map(({ base, frame }) => ({ base, columns: frame })));
      return { kind, columns: { ...columns, raw } };
    }
    if (kind === KIND.lines) {
      const names = [...new Set(parts.flatMap(({ frame }) => frame.lines.map((l) => l.name)))];
      const lines = names.map((name) => {
        const own = parts.flatMap(({ base, frame }) =>
          frame.lines.filter((l) => l.name === name).map((columns) => ({ base, columns })),
        );
        return { name, columns: { ...joinColumns(own), raw } };
      });
      return { kind, lines, more: Math.max(...parts.map(({ frame }) => Number(frame.step))) };
    }
    if (kind === KIND.segments)
      return { kind, segments: joinSegments(parts.map(({ base, frame }) => ({ base, rows: frame.value }))) };
    if (kind === KIND.marks) return { kind, marks: joinMarks(parts) };
    return { kind, frame: frames[0] };
  }

  instantFrame(channel, t) {
    const entry = this.channels.get(channel);
    if (!entry) return this.missingFrame(channel);
    if (!entry.instants) return this.valueFrame(channel, entry, t);
    entry.at ??= (entry.times ?? []).map((time) => this.toRelative(BigInt(time)));
    const found = findMessage(entry.at, t, reachOf(entry.props));
    if (this.shown.get(channel) === found) return this.makeFrame(channel, KIND.same, {});
    this.shown.set(channel, found);
    if (found < 0) return this.makeFrame(channel, KIND.none, {});
    const frame = this.frames[entry.instants[found]];
    // pictures are smaller than the messages, but drawn in their size
    const shown = frame.kind === KIND.image ? { shown: [frame.width, frame.height] } : {};
    return { ...frame, ...shown, channel };
  }

  // The value at the cursor of a stream that is drawn over time is that of its last point.
  valueFrame(channel, entry, t) {
    const { kind, columns, lines } = this.joinParts(entry);
    const drawn = kind === KIND.series ? [{ name: "", columns }] : kind === KIND.lines ? lines : [];
    const last = drawn
      .filter((line) => line.columns.raw)
      .map(({ name, columns: c }) => [name, c, findMessage(c.t, t)])
      .filter(([, , i]) => i >= 0);
    if (!last.length) return this.makeFrame(channel, KIND.none, {});
    const at = Math.max(...last.map(([, c, i]) => c.t[i]));
    const values = last
      .filter(([, c, i]) => c.t[i] === at && !Number.isNaN(c.last[i]))
      .map(([name, c, i]) => [name, String(c.last[i])]);
    return this.makeFrame(channel, KIND.json, { time: this.from + BigInt(Math.round(at)), value: { values } });
  }

  // Returns the samples of a stream's sound between two times, or null; `channel` is a number or "all".
  samples({ stream, channel }, from, to) {
    const part = this.list.sounds.find((s) => {
      const at = this.toRelative(BigInt(s.at));
      return s.stream === stream && at < to && at + (s.count / s.rate) * 1e9 > from;
    });
    if (!part) return null;
    const at = this.toRelative(BigInt(part.at));
    const first = Math.max(Math.round(((from - at) / 1e9) * part.rate), 0);
    const last = Math.min(Math.round(((to - at) / 1e9) * part.rate), part.count);
    const channels = channel === "all" ? [...Array(part.channels).keys()] : [channel];
    const samples = new Float32Array(Math.max(last - first, 0) * channels.length);
    for (let i = first; i < last; i++)
      channels.forEach((c, k) => {
        const sample = this.sounds[part.offset + i * part.channels + c];
        samples[(i - first) * channels.length + k] = sample / 32768;
      });
    return { rate: part.rate, samples, channels: channels.length, at: at + (first / part.rate) * 1e9 };
  }
}

// A connection to the data of the page instead of to a server.
export class PageSocket {
  /** @param {PageData} data */
  constructor(data) {
    this.data = data;
    this.readyState = 1;
    /** @type {(() => void) | null} */
    this.onopen = null;
    /** @type {((event: {data: any}) => void) | null} */
    this.onmessage = null;
    queueMicrotask(() => this.onopen?.());
  }

  send(text) {
    const reply = this.data.answer(JSON.parse(text));
    queueMicrotask(() => this.onmessage?.({ data: reply }));
  }

  close() {
    this.readyState = 3;
  }
}

function joinMarks(parts) {
  const t = parts.flatMap(({ base, frame }) => Array.from(frame.t, (x) => x + base));
  const latency = parts.flatMap(({ frame }) => [...frame.latency]);
  return { t, latency, count: t.length };
}

/** @param {Record<string, any>} props */
function reachOf({ past, future }) {
  const ns = (seconds, otherwise) => (typeof seconds === "number" && seconds >= 0 ? seconds * 1e9 : otherwise);
  return { past: ns(past, Infinity), future: ns(future, 0) };
}

function entryKey({ stream, viz, path = "", props = {} }) {
  return JSON.stringify([stream, viz, path, Object.entries(props ?? {}).sort(([a], [b]) => (a < b ? -1 : 1))]);
}

const align = (bytes) => (bytes + 7) & ~7;
