// The images of one compressed stream, decoded on this page. The cursor sets which one is wanted; images around it are
// decoded and kept. See docs/adr/0189-the-page-decodes-compressed-video.md.

import { FrameCache } from "./frame_cache.js";
import { PacketStore } from "./packet_store.js";
import { packetReader } from "./nal.js";
import { findMissing, planStep, skippable } from "./plan.js";

// The memory for the decoded images of all streams of the page: an eighth of the computer's, from 256 MB to 1 GB.
const MEMORY = /** @type {any} */ (globalThis.navigator)?.deviceMemory ?? 4;
const FRAME_BYTES = Math.min(Math.max(MEMORY * 128, 256), 1024) * 1048576;
const PACKET_BYTES = 64 * 1048576;
// Images that are decoded after the one at the cursor, while it moves and at most during playback. At rest, half of the
// memory is filled.
const AHEAD = 6;
const REST = 150;
// With small copies, another part of the stream is decoded only when the cursor has rested for so many ms.
const HOLD = 60;
const MOST_AHEAD = 40;
// Playback is this far ahead, in ns.
const PLAY_AHEAD = 3e8;
// On the way to the image at the cursor, others are shown at most this often, in ms.
const SHOW_EVERY = 50;
// A server that does not answer is asked again after so many ms.
const RETRY = 1000;

/** @type {Set<VideoSource>} */
const sources = new Set();

function shareMemory() {
  const all = [...sources].reduce((sum, source) => sum + source.share, 0);
  for (const source of sources) source.cache.limit = Math.floor((FRAME_BYTES * source.share) / all);
}

export class VideoSource {
  /**
   * @param {object} options
   * @param {import("./packet_index.js").PacketIndex} options.index
   * @param {string} options.codec
   * @param {Uint8Array} options.description
   * @param {(first: number, count: number) => Promise<ArrayBuffer>} options.fetchBytes
   * @param {() => void} options.changed called when another image can be shown
   * @param {(reason: string) => void} options.failed called when this page cannot decode the stream
   * @param {number} [options.share] the part of the memory for decoded images, compared with other streams
   */
  constructor({ index, codec, description, fetchBytes, changed, failed, share = 1 }) {
    this.index = index;
    this.alone = index.longestGroup() === 1;
    this.reader = packetReader(codec, description);
    this.changed = changed;
    this.failed = failed;
    this.cache = new FrameCache(FRAME_BYTES);
    this.share = share;
    this.store = new PacketStore(index, fetchBytes, PACKET_BYTES);
    this.target = -1;
    this.ahead = AHEAD;
    this.progress = { next: -1, pending: new Set(), flushed: false };
    // whether the decoder has returned an image since it started
    this.fruitful = true;
    this.shownAt = -Infinity;
    this.offline = false;
    this.closed = false;
    this.stats = { decoded: 0, starts: 0 };
    this.frameBytes = 0;
    // whether small copies are shown meanwhile
    this.patient = false;
    this.movedAt = -Infinity;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.resting = undefined;
    sources.add(this);
    shareMemory();
    /** @type {import("./decoder.js").SequenceDecoder | import("./decoder.js").StillDecoder | null} */
    this.decoder = null;
    this.wake = () => {};
  }

  // Begins to decode.
  run(decoder) {
    this.decoder = decoder;
    this.work().catch((error) => this.giveUp(error.message));
  }

  // Takes an image from the decoder.
  accept(number, image, bytes) {
    if (this.closed) return image.close();
    this.stats.decoded++;
    this.frameBytes = bytes;
    this.fruitful = true;
    this.progress.pending.delete(number);
    this.cache.put(number, image, bytes);
    const now = performance.now();
    if (number === this.target || (this.pending && now - this.shownAt >= SHOW_EVERY)) {
      this.shownAt = now;
      this.changed();
    }
    this.wake();
  }

  // Sets the image at the cursor (-1 if there is none). `rate` is the speed of playback, or 0.
  setTarget(image, rate) {
    const [a, b] = [this.index.times[image] ?? 0, this.index.times[image + 1] ?? 0];
    const period = b > a ? b - a : 4e7;
    this.ahead = rate ? Math.min(Math.ceil((PLAY_AHEAD * rate) / period), MOST_AHEAD) : AHEAD;
    if (image !== this.target) {
      this.target = image;
      if (!rate) this.movedAt = performance.now();
      if (image >= 0) this.cache.center = image;
      clearTimeout(this.resting);
      if (!rate) this.resting = setTimeout(() => this.fillAhead(), REST);
    }
    this.wake();
  }

  // At rest, the images after the cursor are decoded, so that a short move finds them. The ones before it were decoded
  // on the way from the key frame.
  fillAhead() {
    const half = Math.floor(this.cache.limit / 2 / Math.max(this.frameBytes, 1));
    if (this.frameBytes) this.ahead = Math.max(this.ahead, half - 2);
    this.wake();
  }

  // Returns what can be shown now: the image at the cursor, or the nearest one until it is decoded.
  /** @returns {{number: number, image: any, exact: boolean} | null} */
  current() {
    if (this.target < 0) return null;
    const exact = this.cache.has(this.target);
    const number = exact ? this.target : this.cache.nearest(this.target, 0, this.index.imageCount);
    this.cache.shown = number;
    return number < 0 ? null : { number, image: this.cache.get(number), exact };
  }

  get pending() {
    return this.target >= 0 && !this.cache.has(this.target);
  }

  async work() {
    while (!this.closed) {
      const image = findMissing(this.index, this.cache, this.target, this.ahead);
      if (image < 0) await new Promise((resolve) => (this.wake = () => resolve(null)));
      else await this.step(image);
    }
  }

  async step(image) {
    const plan = planStep(this.index, this.progress, image);
    if (plan === "lost") return this.giveUp("its decoder did not return every image");
    if (plan === "flush") return this.flush();
    // Another start would not show anything if the last one has not yet.
    if (typeof plan === "object" && this.fruitful) {
      const rested = performance.now() - this.movedAt;
      return this.patient && rested < HOLD ? this.waitForRest(HOLD - rested) : this.start(plan.start);
    }
    if (this.progress.next >= this.index.count) return this.flush();
    // Further packets are needed only if those that wait do not suffice.
    if (this.progress.pending.has(image)) await this.decoder?.drain();
    if (this.cache.has(image)) return;
    return this.feed(image);
  }

  waitForRest(ms) {
    return new Promise((resolve) => setTimeout(resolve, ms));
  }

  async start(key) {
    if (key < 0) return this.giveUp("it has no key frame before the cursor");
    const bytes = await this.loadPacket(key);
    if (!bytes || this.closed) return;
    if (this.reader && !this.reader.startsDecoding(bytes)) return this.index.dropKey(key);
    // A decoder of images that are all key frames continues with any of them.
    if (!this.alone || this.stats.starts === 0) this.decoder?.start();
    this.stats.starts++;
    this.fruitful = false;
    this.progress = { next: key, pending: new Set(), flushed: false };
  }

  async feed(image) {
    const { progress } = this;
    const packet = progress.next;
    const bytes = await this.loadPacket(packet);
    if (!bytes || this.closed) return;
    const number = this.index.images[packet];
    progress.next = packet + 1;
    if (this.reader && skippable(this.index, packet, image) && !this.reader.needed(bytes)) return;
    if (number >= 0) progress.pending.add(number);
    this.decoder?.feed(bytes, this.index.isKey(packet), number);
    await this.decoder?.ready();
  }

  async flush() {
    await this.decoder?.flush();
    this.progress.flushed = true;
    this.fruitful = true;
  }

  // Returns the bytes of a packet, or null if the cursor has to be looked at again first.
  async loadPacket(packet) {
    const here = this.store.get(packet);
    if (here) {
      this.loadNext(packet);
      return here;
    }
    try {
      await this.store.load(packet);
      this.setOffline(false);
      return null;
    } catch (error) {
      // The server has an answer that will not change: it cannot read this part of the file.
      if (error.status) this.giveUp(error.message);
      else await this.waitForServer();
      return null;
    }
  }

  loadNext(packet) {
    const [, end] = this.index.partOf(packet);
    if (end < this.index.count && !this.index.isKey(end)) this.store.load(end).catch(() => {});
  }

  async waitForServer() {
    this.setOffline(true);
    await new Promise((resolve) => setTimeout(resolve, RETRY));
  }

  setOffline(offline) {
    if (offline === this.offline) return;
    this.offline = offline;
    this.changed();
  }

  giveUp(reason) {
    if (this.closed) return;
    this.close();
    this.failed(reason);
  }

  close() {
    this.closed = true;
    clearTimeout(this.resting);
    sources.delete(this);
    shareMemory();
    this.wake();
    this.decoder?.close();
    this.cache.clear();
  }
}
