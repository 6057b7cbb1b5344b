// Shows a compressed stream in an image panel: the page decodes it if it can, and the server otherwise. The decoding
// code is a separate module that the page loads with the first such stream.

import { scriptAddress } from "../page/dom.js";
import { formatDuration } from "../time/text.js";

const HERE = scriptAddress() ?? location.href;
/** @type {Promise<typeof import("../video/index.js")> | null} */
let decoding = null;
const loadDecoding = () => (decoding ??= import(new URL("video.js", HERE).href));

const seconds = (value, usual) => (typeof value === "number" && value >= 0 ? value * 1e9 : usual);

export class VideoLayer {
  /**
   * @param {any} app
   * @param {any} layer the panel's layer, whose picture is set
   * @param {object} options
   * @param {() => void} options.changed called when there is something new to draw
   * @param {(layer: any) => void} options.opened called when the page takes over from the server
   * @param {(layer: any) => void} options.failed called when the server has to take over again
   */
  constructor(app, layer, { changed, opened, failed }) {
    this.app = app;
    this.layer = layer;
    this.changed = changed;
    this.opened = opened;
    this.failed = failed;
    // why the server decodes the stream, if it is compressed
    this.reason = "";
    this.begun = false;
    this.closed = false;
    /** @type {import("../video/source.js").VideoSource | null} */
    this.source = null;
    this.start = 0n;
    /** @type {string | null | undefined} the offset of the compared recording when the index was read */
    this.offset = null;
  }

  // Called with the first image from the server.
  begin() {
    if (this.begun) return;
    this.begun = true;
    this.open().catch((error) => this.useServer(error.message));
  }

  async open() {
    const offset = this.app.client.offset;
    const described = await this.fetchIndex();
    if (this.closed) return;
    if (!described.codec) return described.problem && this.useServer(described.problem);
    const { openVideo } = await loadDecoding();
    const found = await openVideo(described, {
      fetchBytes: (first, count) => this.fetchBytes(first, count),
      changed: this.changed,
      failed: (reason) => this.useServer(reason),
    });
    if (found.reason !== undefined) return this.useServer(found.reason);
    if (this.closed) return found.source.close();
    Object.assign(this, { source: found.source, start: found.start, offset });
    this.opened(this.layer);
    this.update();
  }

  address(what, more = {}) {
    const query = new URLSearchParams({ stream: this.layer.vis.stream, ...more });
    return `${this.app.options.videoUrl(what)}&${query}`;
  }

  async fetchIndex() {
    const response = await fetch(this.address("video"));
    if (!response.ok) throw new Error(await response.text());
    return response.json();
  }

  async fetchBytes(first, count) {
    const response = await fetch(this.address("packets", { first, count }));
    // an error with a status is an answer; without one, the server could not be reached
    if (!response.ok) throw Object.assign(new Error(await response.text()), { status: response.status });
    return response.arrayBuffer();
  }

  // Returns the page's time of the index's zero. The offset of a compared recording may have changed.
  zero() {
    const { client } = this.app;
    const moved = this.layer.vis.stream.includes("Compared.") && client.offset != null && this.offset != null;
    return client.toRelative(this.start) + (moved ? Number(BigInt(client.offset) - BigInt(this.offset ?? 0)) : 0);
  }

  // Follows the cursor. Returns whether the page decodes the stream.
  update() {
    if (!this.source) return false;
    const s = this.app.time.get();
    const { asked } = this.layer.vis;
    const past = seconds(asked?.past, Infinity),
      future = seconds(asked?.future, 0);
    const image = this.source.index.imageAt(Math.round(s.cursor) - this.zero(), past, future);
    this.source.setTarget(image, s.mode === "play" ? s.speed : 0);
    this.changed();
    return true;
  }

  // Sets the layer's picture to the decoded one.
  apply() {
    const { source, layer } = this;
    if (!source) return;
    const found = source.current();
    layer.decoding = source.pending && !source.offline;
    // until the first image is decoded, that of the server stays
    if (!found && source.target >= 0) return;
    layer.drawer.close(layer);
    if (!found) return;
    const { image } = found;
    const size = { width: image.displayWidth ?? image.width, height: image.displayHeight ?? image.height };
    // the source closes the image
    layer.picture = { image, ...size, borrowed: true };
    layer.at = source.index.times[found.number] + this.zero();
  }

  // Yields what the corner of the panel says about the decoding.
  *facts(cursor) {
    if (this.reason) yield `decoded by the server: ${this.reason}`;
    if (this.source?.offline) yield "the server does not respond; the video continues when it does";
    else if (this.source?.pending) {
      const away = cursor - this.layer.at;
      if (Math.abs(away) > 0)
        yield `decoding: ${formatDuration(Math.abs(away))} ${away > 0 ? "before" : "after"} the cursor`;
    }
  }

  useServer(reason) {
    if (this.closed) return;
    this.reason = reason.trim().replace(/\.$/, "");
    const had = this.source;
    this.source = null;
    this.layer.decoding = false;
    if (had) {
      this.layer.picture = null;
      had.close();
      this.failed(this.layer);
    }
    this.changed();
  }

  close() {
    this.closed = true;
    this.source?.close();
    this.source = null;
  }
}
