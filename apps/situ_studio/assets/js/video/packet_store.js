// The bytes of packets: fetched in parts, and kept up to a limit. The parts that were used longest ago are dropped.

export class PacketStore {
  /**
   * @param {import("./packet_index.js").PacketIndex} index
   * @param {(first: number, count: number) => Promise<ArrayBuffer>} fetchBytes
   * @param {number} limit the number of bytes to keep
   */
  constructor(index, fetchBytes, limit) {
    this.index = index;
    this.fetchBytes = fetchBytes;
    this.limit = limit;
    this.bytes = 0;
    /** @type {Map<number, {end: number, bytes: Uint8Array | null, offsets: number[], arrived: Promise<void>}>} */
    this.parts = new Map();
  }

  // Returns the bytes of a packet if they are here, else null.
  get(packet) {
    const [first] = this.index.partOf(packet);
    const part = this.parts.get(first);
    if (!part?.bytes) return null;
    // moves it to the end of the order of use
    this.parts.delete(first);
    this.parts.set(first, part);
    const from = part.offsets[packet - first];
    return part.bytes.subarray(from, from + this.index.sizes[packet]);
  }

  // Fetches the part of a packet. Rejects if the server does not send it.
  load(packet) {
    const [first, end] = this.index.partOf(packet);
    const held = this.parts.get(first);
    if (held) return held.arrived;
    const part = { end, bytes: null, offsets: [], arrived: Promise.resolve() };
    part.arrived = this.fetchPart(first, part).catch((error) => {
      if (this.parts.get(first) === part) this.parts.delete(first);
      throw error;
    });
    this.parts.set(first, part);
    return part.arrived;
  }

  async fetchPart(first, part) {
    const bytes = new Uint8Array(await this.fetchBytes(first, part.end - first));
    let at = 0;
    for (let p = first; p < part.end; p++) {
      part.offsets.push(at);
      at += this.index.sizes[p];
    }
    if (at !== bytes.length) throw new Error("the server sent another number of bytes than its index states");
    part.bytes = bytes;
    this.bytes += bytes.length;
    this.dropOldest(first);
  }

  dropOldest(newest) {
    for (const [first, part] of this.parts) {
      if (this.bytes <= this.limit) return;
      if (!part.bytes || first === newest) continue;
      this.parts.delete(first);
      this.bytes -= part.bytes.length;
    }
  }
}
