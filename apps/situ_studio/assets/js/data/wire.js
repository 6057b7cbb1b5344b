// Decodes the binary replies of the data socket (docs: `Situ.Studio.Frame`). Little endian; every payload starts at
// a multiple of 8, so that typed arrays can view the buffer without copying. The headers are in `frames.js`.

import {
  FORMAT,
  FRAME_BYTES,
  FRAME_FLAG,
  IMAGE_BYTES,
  KIND,
  LINE_BYTES,
  REPLY_BYTES,
  REPLY_FLAG,
  readFrame,
  readImage,
  readLine,
  readReply,
} from "./frames.js";
import { decodeScene } from "./scene.js";

const text = new TextDecoder();
const COLUMNS_BYTES = 40;

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
  const view = new DataView(buffer);
  if (view.byteLength < REPLY_BYTES || view.getUint8(0) !== FORMAT.reply)
    throw new Error(`not a data frame of version ${FORMAT.reply}`);
  const { flags, count, request, from, to, version, time } = readReply(view, 0);
  /** @type {Reply} */
  const reply = {
    request,
    live: (flags & REPLY_FLAG.live) !== 0,
    gone: (flags & REPLY_FLAG.gone) !== 0,
    replaced: (flags & REPLY_FLAG.replaced) !== 0,
    from,
    to,
    version,
    time,
    frames: [],
  };
  let at = REPLY_BYTES;
  for (let i = 0; i < count; i++) {
    const head = readFrame(view, at);
    at += FRAME_BYTES;
    if (at + head.bytes > view.byteLength) throw new Error("data frame cut short");
    reply.frames.push(readPayload({ ...head, step: Number(head.step) }, buffer, at));
    at += (head.bytes + 7) & ~7;
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
    const { bytes, count: n } = readLine(v, at);
    at += LINE_BYTES;
    const name = text.decode(new Uint8Array(buffer, at, bytes));
    at += (bytes + 7) & ~7;
    out.push({ name, raw, sampled, ...readColumns(buffer, at, n) });
    at += COLUMNS_BYTES * n;
  }
  return out;
}

function readPayload(f, buffer, at) {
  const n = f.count;
  // raw: single messages instead of summaries; sampled: a sample of a larger number of messages
  f.raw = (f.flags & FRAME_FLAG.raw) !== 0;
  f.sampled = (f.flags & FRAME_FLAG.sampled) !== 0;
  // all audio channels together, although a single one was requested
  f.together = (f.flags & FRAME_FLAG.together) !== 0;
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
    case KIND.image:
      f.data = new Uint8Array(buffer, at + IMAGE_BYTES, f.bytes - IMAGE_BYTES);
      return Object.assign(f, readImage(new DataView(buffer), at));
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
