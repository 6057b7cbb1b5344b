// The index of a compressed stream: which image is the one at a time, and which packets a decoder needs for it.
//
// Packets are numbered in the order in which a decoder needs them, images in the order of their times.

// Packets are fetched in parts of about this size in bytes. A part that begins with a key frame is small, so that the
// key frame arrives early.
const FIRST_PART = 262144;
const PART = 1048576;
const KEY = 1,
  HIDDEN = 2;

/**
 * @typedef {object} IndexColumns
 * @property {Float64Array} times the time of each packet's image in ns, relative to `start`
 * @property {Uint32Array} sizes
 * @property {Uint8Array} flags 1 key frame, 2 not shown
 */

// Reads the three columns of the server's index (`Situ.Studio.CodedStreams`).
/**
 * @param {ArrayBuffer} buffer
 * @param {number} count
 * @returns {IndexColumns}
 */
export function readColumns(buffer, count) {
  if (buffer.byteLength !== count * 13) throw new Error("the index of the video is damaged");
  const steps = new BigInt64Array(buffer, 0, count);
  const times = new Float64Array(count);
  for (let i = 0, t = 0; i < count; i++) times[i] = t += Number(steps[i]);
  return {
    times,
    sizes: new Uint32Array(buffer, 8 * count, count),
    flags: new Uint8Array(buffer, 12 * count, count),
  };
}

export class PacketIndex {
  /** @param {IndexColumns} columns */
  constructor({ times, sizes, flags }) {
    this.sizes = sizes;
    this.flags = flags;
    this.count = sizes.length;
    const shown = [];
    for (let p = 0; p < this.count; p++) if (!(flags[p] & HIDDEN)) shown.push(p);
    shown.sort((a, b) => times[a] - times[b]);
    // from image to packet and time, and from packet to image (-1 if it is not shown)
    this.packets = Uint32Array.from(shown);
    this.times = Float64Array.from(shown, (p) => times[p]);
    this.images = new Int32Array(this.count).fill(-1);
    this.packets.forEach((p, image) => (this.images[p] = image));
    this.parts = this.listParts();
  }

  get imageCount() {
    return this.times.length;
  }

  // Returns the number of the last image at or before a time, or -1.
  lastAt(t) {
    let low = 0,
      high = this.times.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] <= t) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  // Returns the image that the server would choose at a time, or -1: the last one, or the nearest one of those that are
  // at most `past` ns before and `future` ns after it.
  imageAt(t, past = Infinity, future = 0) {
    const before = this.lastAt(t);
    const near = [];
    if (before >= 0 && t - this.times[before] <= past) near.push(before);
    const next = before + 1;
    if (future > 0 && next < this.times.length && this.times[next] - t <= future) near.push(next);
    if (past === Infinity && future === 0) return before;
    const away = (i) => Math.abs(this.times[i] - t);
    return near.sort((a, b) => away(a) - away(b))[0] ?? -1;
  }

  isKey(packet) {
    return (this.flags[packet] & KEY) !== 0;
  }

  // Forgets that a decoder can start at a packet.
  dropKey(packet) {
    this.flags[packet] &= ~KEY;
  }

  // Returns the last packet at or before this one where a decoder can start, or -1.
  keyBefore(packet) {
    let p = packet;
    while (p >= 0 && !this.isKey(p)) p--;
    return p;
  }

  // Returns the largest number of packets from one key frame to the next.
  longestGroup() {
    let longest = 0,
      key = 0;
    for (let p = 0; p <= this.count; p++)
      if (p === this.count || this.isKey(p)) {
        longest = Math.max(longest, p - key);
        key = p;
      }
    return longest;
  }

  // Returns the packet after this one where a decoder can start, or the number of packets.
  keyAfter(packet) {
    let p = packet + 1;
    while (p < this.count && !this.isKey(p)) p++;
    return p;
  }

  // Returns [first, end) of the part that contains a packet.
  partOf(packet) {
    let low = 0,
      high = this.parts.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.parts[middle] <= packet) low = middle + 1;
      else high = middle;
    }
    return [this.parts[low - 1], this.parts[low] ?? this.count];
  }

  // Lists the first packets of all parts.
  listParts() {
    const starts = this.count ? [0] : [];
    let bytes = 0,
      limit = FIRST_PART;
    for (let p = 0; p < this.count; p++) {
      const full = bytes + this.sizes[p] > limit,
        group = this.isKey(p) && bytes > FIRST_PART / 2;
      if (bytes > 0 && (full || group)) {
        starts.push(p);
        bytes = 0;
        limit = this.isKey(p) ? FIRST_PART : PART;
      }
      bytes += this.sizes[p];
    }
    return starts;
  }
}
