// Decoded images around the cursor. The images that are furthest from it are closed first, so the memory is bounded.

export class FrameCache {
  /** @param {number} limit the number of bytes to hold */
  constructor(limit) {
    this.limit = limit;
    this.bytes = 0;
    /** @type {Map<number, {image: any, bytes: number}>} */
    this.frames = new Map();
    this.center = 0;
    // the image that is on the screen, which is not closed
    this.shown = -1;
  }

  get(number) {
    return this.frames.get(number)?.image ?? null;
  }

  has(number) {
    return this.frames.has(number);
  }

  // Keeps an image. An image that is there already is replaced.
  put(number, image, bytes) {
    this.drop(number);
    this.frames.set(number, { image, bytes });
    this.bytes += bytes;
    this.evict();
  }

  drop(number) {
    const frame = this.frames.get(number);
    if (!frame) return;
    this.frames.delete(number);
    this.bytes -= frame.bytes;
    frame.image.close();
  }

  evict() {
    while (this.bytes > this.limit && this.frames.size > 1) {
      const far = this.furthest();
      if (far === null) return;
      this.drop(far);
    }
  }

  furthest() {
    /** @type {number | null} */
    let found = null;
    let most = -1;
    for (const number of this.frames.keys()) {
      const away = Math.abs(number - this.center);
      if (away > most && number !== this.shown && number !== this.center) [found, most] = [number, away];
    }
    return found;
  }

  // Returns the held image nearest to a number in from..to, or -1.
  nearest(number, from, to) {
    let found = -1;
    for (const n of this.frames.keys()) {
      if (n < from || n > to) continue;
      if (found < 0 || Math.abs(n - number) < Math.abs(found - number)) found = n;
    }
    return found;
  }

  clear() {
    for (const number of [...this.frames.keys()]) this.drop(number);
  }
}
