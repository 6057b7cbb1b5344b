// Decodes the binary replies of the data socket (docs: `Situ.Studio.Frame`). Little endian; every payload starts at
// a multiple of 8, so that typed arrays can view the buffer without copying.

import { decodeScene } from "./scene.js";

export const KIND = {
  series: 1,
  segments: 2,
  marks: 3,
  image: 4,
  json: 5,
  none: 6,
  same: 7,
  error: 8,
  pcm: 9,
  lines: 10,
  scene: 11,
  sounds: 12,
};
export const PIXELS = { jpeg: 1, png: 2, rgba: 3, gray8: 4, gray16: 5, rgb: 6, bgr: 7, bgra: 8 };

const HEAD = 40,
  FRAME = 32;
const text = new TextDecoder();

/**
 * @typedef {object} Reply
 * @property {number} request
 * @property {boolean} live
 * @property {boolean} gone
 * @property {boolean} replaced
 * @property {bigint} from
 * @property {bigint} to
 * @property {number} version
 * @property {bigint} time
 * @property {any[]} frames depend on their kind; see `readPayload`
 * @property {boolean} [first] set by the client, like the following properties
 * @property {object | null} [asked]
 * @property {number} [cursor]
 */

/**
 * @param {ArrayBuffer} buffer
 * @returns {Reply}
 */
export function decodeReply(buffer) {
  const v = new DataView(buffer);
  if (v.byteLength < HEAD || v.getUint8(0) !== 1) throw new Error("not a data frame of version 1");
  const flags = v.getUint16(2, true);
  /** @type {Reply} */
  const reply = {
    request: v.getUint32(4, true),
    live: (flags & 1) === 1,
    gone: (flags & 2) === 2,
    replaced: (flags & 4) === 4,
    from: v.getBigInt64(8, true),
    to: v.getBigInt64(16, true),
    version: v.getUint32(28, true),
    time: v.getBigInt64(32, true),
    frames: [],
  };
  const n = v.getUint32(24, true);
  let at = HEAD;
  for (let i = 0; i < n; i++) {
    const kind = v.getUint16(at, true);
    const frame = {
      kind,
      flags: v.getUint16(at + 2, true),
      channel: v.getUint32(at + 4, true),
      bytes: v.getUint32(at + 8, true),
      count: v.getUint32(at + 12, true),
      time: v.getBigInt64(at + 16, true),
      step: Number(v.getBigInt64(at + 24, true)),
    };
    at += FRAME;
    if (at + frame.bytes > v.byteLength) throw new Error("data frame cut short");
    reply.frames.push(readPayload(frame, buffer, at));
    at += (frame.bytes + 7) & ~7;
  }
  return reply;
}

// Reads five columns of n: offset from the frame's time in ns, min, max, last, count.
function readColumns(buffer, at, n) {
  const readColumn = (i) => new Float64Array(buffer, at + 8 * n * i, n);
  return {
    count: n,
    t: readColumn(0),
    min: readColumn(1),
    max: readColumn(2),
    last: readColumn(3),
    n: readColumn(4),
  };
}

function readLines(buffer, at, count, { raw, sampled }) {
  const v = new DataView(buffer);
  const out = [];
  for (let i = 0; i < count; i++) {
    const size = v.getUint32(at, true),
      n = v.getUint32(at + 4, true);
    const name = text.decode(new Uint8Array(buffer, at + 8, size));
    at += 8 + ((size + 7) & ~7);
    out.push({ name, raw, sampled, ...readColumns(buffer, at, n) });
    at += 40 * n;
  }
  return out;
}

function readPayload(f, buffer, at) {
  const n = f.count;
  // raw: single messages instead of summaries; sampled: a sample of a larger number of messages
  f.raw = (f.flags & 1) === 1;
  f.sampled = (f.flags & 2) === 2;
  // all audio channels together, although a single one was requested
  f.together = (f.flags & 4) === 4;
  switch (f.kind) {
    case KIND.series:
      return Object.assign(f, readColumns(buffer, at, n));
    case KIND.lines:
      f.lines = readLines(buffer, at, n, f);
      return f;
    case KIND.marks:
      f.t = new Float64Array(buffer, at, n);
      f.latency = new Float64Array(buffer, at + 8 * n, n);
      return f;
    case KIND.image: {
      const v = new DataView(buffer, at, 16);
      f.width = v.getUint32(0, true);
      f.height = v.getUint32(4, true);
      f.pixels = v.getUint32(8, true);
      f.unit = v.getUint32(12, true);
      f.data = new Uint8Array(buffer, at + 16, f.bytes - 16);
      return f;
    }
    case KIND.pcm:
      f.rate = f.step;
      f.samples = new Float32Array(buffer, at, f.bytes / 4);
      f.channels = n ? f.samples.length / n : 1;
      return f;
    case KIND.sounds:
      f.rate = f.step;
      f.t = new Float64Array(buffer, at, n);
      f.samples = new Float32Array(buffer, at + 8 * n, (f.bytes - 8 * n) / 4);
      return f;
    case KIND.segments:
    case KIND.json:
      f.value = JSON.parse(text.decode(new Uint8Array(buffer, at, f.bytes)));
      return f;
    case KIND.scene:
      return Object.assign(f, decodeScene(buffer, at, f.bytes));
    case KIND.error:
      f.message = text.decode(new Uint8Array(buffer, at, f.bytes));
      return f;
    default:
      return f;
  }
}
