// Shows a compressed stream in an image panel: the page decodes it if it can, and the server otherwise. The decoding
// code is a separate module that the page loads with the first such stream.

import { scriptAddress } from "../page/dom.js";

const HERE = scriptAddress() ?? location.href;
/** @type {Promise<typeof import("../video/index.js")> | null} */
let decoding = null;
const loadDecoding = () => (decoding ??= import(new URL("video.js", HERE).href));

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
    /** @type {import("../video/film.js").Film | null} */
    this.film = null;
  }

  get source() {
    return this.film?.source ?? null;
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
    const { openFilm } = await loadDecoding();
    const film = await openFilm(this, described, offset);
    if (film.reason !== undefined) return this.useServer(film.reason);
    if (this.closed) return film.close();
    this.film = film;
    this.opened(this.layer);
    this.update();
  }

  address(what, more = {}) {
    const query = new URLSearchParams({ stream: this.layer.vis.stream, ...more });
    return `${this.app.options.videoUrl(what)}&${query}`;
  }

  async fetchIndex(more = {}) {
    const response = await fetch(this.address("video", more));
    if (!response.ok) throw new Error(await response.text());
    return response.json();
  }

  // Follows the cursor. Returns whether the page decodes the stream.
  update() {
    if (!this.film) return false;
    this.film.follow();
    this.changed();
    return true;
  }

  // Sets the layer's picture to the decoded one.
  apply() {
    this.film?.apply();
  }

  // Yields what the corner of the panel says about the decoding.
  *facts(cursor) {
    if (this.reason) yield `decoded by the server: ${this.reason}`;
    if (this.film) yield* this.film.facts(cursor);
  }

  useServer(reason) {
    if (this.closed) return;
    this.reason = reason.trim().replace(/\.$/, "");
    const had = this.film;
    this.film = null;
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
    this.film?.close();
    this.film = null;
  }
}
