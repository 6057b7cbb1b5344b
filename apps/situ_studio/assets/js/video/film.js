// A compressed stream in a panel: the image at the cursor, or the nearest one until it is decoded.

import { formatDuration } from "../time/text.js";
import { openSmall, openVideo } from "./open.js";

// The time between two small copies, in ns.
const SMALL_STEP = 1e8;

const seconds = (value, usual) => (typeof value === "number" && value >= 0 ? value * 1e9 : usual);

/** @typedef {{source: import("./source.js").VideoSource, start: bigint, reason?: undefined}} Opened */

// Opens a stream from the server's description. Returns the reason if this page cannot decode it.
/**
 * @param {import("../visualizers/video_layer.js").VideoLayer} owner
 * @param {any} described
 * @param {string | null | undefined} offset of the compared recording when the stream was described
 * @returns {Promise<Film | {reason: string}>}
 */
export async function openFilm(owner, described, offset) {
  const opened = await openVideo(described, {
    fetchBytes: (first, count) => fetchBytes(owner, { first, count }),
    changed: owner.changed,
    failed: (reason) => owner.useServer(reason),
  });
  return opened.reason === undefined ? new Film(owner, opened, described, offset) : opened;
}

async function fetchBytes(owner, query) {
  const response = await fetch(owner.address("packets", query));
  // an error with a status is an answer; without one, the server could not be reached
  if (!response.ok) throw Object.assign(new Error(await response.text()), { status: response.status });
  return response.arrayBuffer();
}

export class Film {
  /**
   * @param {import("../visualizers/video_layer.js").VideoLayer} owner
   * @param {Opened} opened
   * @param {any} described
   * @param {string | null | undefined} offset
   */
  constructor(owner, { source, start }, described, offset) {
    /** @type {undefined} */
    this.reason = undefined;
    this.owner = owner;
    this.source = source;
    // the zero of the times of the index, in ns since 1970
    this.start = start;
    this.offset = offset;
    const { width, height, rotation } = described;
    this.size = rotation % 180 ? { width: height, height: width } : { width, height };
    // whether the picture is not the image at the cursor
    this.approximate = false;
    this.closed = false;
    /** @type {Opened | null} small copies, which are shown while the cursor moves */
    this.small = null;
    this.openSmall().catch(() => {});
  }

  async openSmall() {
    const { owner } = this;
    const small = await openSmall(this.source, {
      describe: () => owner.fetchIndex({ small: 1 }),
      fetchBytes: (first, count) => fetchBytes(owner, { first, count, small: 1 }),
      changed: owner.changed,
      closed: () => this.closed,
    });
    if (this.closed) small?.source.close();
    else this.small = small;
    this.source.patient = this.small !== null;
  }

  // Returns the page's time of an index's zero. The offset of a compared recording may have changed.
  zero(start = this.start) {
    const { client } = this.owner.app;
    const compared = this.owner.layer.vis.stream.includes("Compared.");
    const moved = compared && client.offset != null && this.offset != null;
    return client.toRelative(start) + (moved ? Number(BigInt(client.offset) - BigInt(this.offset ?? 0)) : 0);
  }

  timeOf(image, { source, start } = /** @type {Opened} */ (this)) {
    return source.index.times[image] + this.zero(start);
  }

  // Looks for the image at the cursor.
  follow() {
    const s = this.owner.app.time.get();
    const { asked } = this.owner.layer.vis;
    const past = seconds(asked?.past, Infinity),
      future = seconds(asked?.future, 0);
    const image = this.source.index.imageAt(Math.round(s.cursor) - this.zero(), past, future);
    this.source.setTarget(image, s.mode === "play" ? s.speed : 0);
    this.followSmall();
  }

  // Small copies are needed only until the image at the cursor is decoded.
  followSmall() {
    if (!this.small) return;
    const { source, start } = this.small;
    const time = this.timeOf(this.source.target) - this.zero(start);
    source.setTarget(this.source.pending ? Math.max(source.index.lastAt(time + SMALL_STEP / 2), 0) : -1, 0);
  }

  // Returns the picture that is nearest to the image at the cursor, and its time.
  nearest() {
    const held = this.source.current();
    const large = held && { ...held, small: false, at: this.timeOf(held.number) };
    const copy = held?.exact ? null : this.small?.source.current();
    if (!copy) return large;
    const small = {
      ...copy,
      exact: false,
      small: true,
      at: this.timeOf(copy.number, /** @type {Opened} */ (this.small)),
    };
    const away = (/** @type {{at: number}} */ picture) => Math.abs(picture.at - this.timeOf(this.source.target));
    return large && away(large) <= away(small) ? large : small;
  }

  // Sets the layer's picture to the nearest one.
  apply() {
    const { layer } = this.owner;
    const found = this.nearest();
    layer.decoding = this.source.pending && !this.source.offline;
    this.approximate = found !== null && !found.exact;
    // until the first image is decoded, that of the server stays
    if (!found && this.source.target >= 0) return;
    layer.drawer.close(layer);
    if (!found) return;
    const { image } = found;
    // a small copy is shown in the size of the image
    if (!found.small) this.size = sizeOf(image);
    // the source closes the image
    layer.picture = { image, ...this.size, borrowed: true };
    layer.at = found.at;
  }

  // Yields what the corner of the panel says about the decoding.
  *facts(cursor) {
    if (this.source.offline) yield "the server does not respond; the video continues when it does";
    else if (this.source.pending && this.approximate) {
      const away = cursor - this.owner.layer.at;
      yield `approximate: ${formatDuration(Math.abs(away))} ${away > 0 ? "before" : "after"} the cursor; decoding`;
    }
  }

  close() {
    this.closed = true;
    this.source.close();
    this.small?.source.close();
    this.small = null;
  }
}

const sizeOf = (image) => ({ width: image.displayWidth ?? image.width, height: image.displayHeight ?? image.height });
