// A map panel: tracks of positions, and the positions at the cursor. Map tiles are only loaded if the user
// configured their address or folder.

import { KIND } from "../data/frames.js";
import { groundDistance, toLatitude, toLongitude, toX, toY } from "../map/mercator.js";
import { nearestPoint, TrackChannel, countUntil } from "../map/track.js";
import { drawGrid, drawPosition, drawScale, drawTiles, drawTrack } from "../map/draw.js";
import { formatNumber } from "../page/number_text.js";
import { seriesColor, themeColors } from "../page/theme.js";
import { showTip } from "../page/tip.js";
import { formatAbsolute, formatRelative } from "../time/text.js";

const NEAR = 10;
const [FAR_OUT, CLOSE] = [128, 2 ** 32];
// The number of tiles that are cached.
const TILES = 300;

export class MapPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    this.layers = [];
    this.tiles = new Map();
    el.classList.add("map-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.canvas.className = "own-canvas";
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("aria-label", "Map: arrow keys move it, plus and minus zoom, 0 shows everything");
    this.info = el.appendChild(document.createElement("div"));
    this.info.className = "cell-info";
    const { tiles, credit } = app.root.dataset;
    // tiles of a folder are served below the studio's own path
    this.address = tiles?.startsWith("/") ? (app.options.base ?? "") + tiles : tiles;
    this.credit = credit;
    this.addListeners();
    this.observer = new ResizeObserver(() => app.scheduleDraw(this));
    this.observer.observe(el);
    this.configure(config);
  }

  configure(config) {
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.viz, vis.stream, vis.path]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    this.app.scheduleDraw(this);
  }

  openLayer(key, vis) {
    const layer = { key, vis };
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path };
    const { client } = this.app;
    layer.now = client.openChannel(spec, (frame) => this.acceptFrame(layer, frame), { instant: true });
    layer.way = client.addChannel((id) => new TrackChannel(id, spec, (track) => this.setTrack(layer, track)));
    return layer;
  }

  closeLayer(layer) {
    this.app.client.closeChannel(layer.now);
    this.app.client.closeChannel(layer.way);
  }

  acceptFrame(layer, frame) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    const v = frame.kind === KIND.json ? frame.value : null;
    layer.place = v && { ...v, x: toX(v.longitude), y: toY(v.latitude) };
    layer.at = frame.at;
    this.app.scheduleDraw(this);
  }

  setTrack(layer, track) {
    layer.track = track;
    // everything is in view until the viewer moves the map
    if (!this.moved) this.fitTracks();
    this.app.scheduleDraw(this);
  }

  get visibleLayers() {
    return this.layers.filter((l) => l.vis.props?.visible !== false);
  }

  fitTracks() {
    let [x0, y0, x1, y1] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const { track } of this.visibleLayers)
      for (let i = 0; i < (track?.count ?? 0); i++) {
        [x0, x1] = [Math.min(x0, track.x[i]), Math.max(x1, track.x[i])];
        [y0, y1] = [Math.min(y0, track.y[i]), Math.max(y1, track.y[i])];
      }
    const { clientWidth: w, clientHeight: h } = this.el;
    if (!(x0 <= x1) || !w || !h) return;
    const px = Math.min((w * 0.86) / Math.max(x1 - x0, 1e-9), (h * 0.8) / Math.max(y1 - y0, 1e-9), 2 ** 27);
    this.map = { px, x: (x0 + x1 - w / px) / 2, y: (y0 + y1 - h / px) / 2 };
    this.fitted = `${w} ${h}`;
  }

  render() {
    const { clientWidth: w, clientHeight: h } = this.el;
    if (!w || !h) return;
    if (!this.moved && this.fitted !== `${w} ${h}`) this.fitTracks();
    this.map ??= { px: Math.max(w, 256), x: 0, y: 0.2 };
    const { canvas, map } = this;
    const [cw, ch] = [w, h].map((v) => Math.round(v * devicePixelRatio));
    if (canvas.width !== cw || canvas.height !== ch) Object.assign(canvas, { width: cw, height: ch });
    const ctx = canvas.getContext("2d");
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    const colors = themeColors();
    if (this.address) drawTiles(ctx, map, w, h, (tile) => this.fetchTile(tile));
    else drawGrid(ctx, map, w, h, colors);
    const { cursor } = this.app.time.get();
    for (const layer of this.visibleLayers) {
      const { vis, track, place, index } = layer;
      const color = seriesColor(vis.props?.color, vis.color ?? index);
      const { width = 3, points = false, accuracy = true } = vis.props ?? {};
      if (track) drawTrack(ctx, map, { track, color, width, points }, cursor);
      if (place) drawPosition(ctx, map, { place, color, accuracy }, colors);
    }
    drawScale(ctx, map, w, h, colors, this.address && this.credit);
    this.updateNote();
    const at = this.layers.map((l) => l.at).filter((t) => t != null);
    if (at.length) canvas.dataset.at = String(Math.max(...at));
  }

  updateNote() {
    const errors = this.layers.flatMap((l) => {
      const error = l.error ?? l.way.error;
      return error ? [`${l.vis.short}: ${error}`] : [];
    });
    const places = this.visibleLayers.filter((l) => l.place).map((l) => this.describePosition(l));
    this.info.textContent = [...errors, ...places].join("\n") || "no position at the cursor";
    this.info.classList.toggle("bad", errors.length > 0);
  }

  describePosition({ vis, place }) {
    const { latitude, longitude, height, accuracy } = place;
    const more = [
      height == null ? "" : `, ${formatNumber(height, 4)} m high`,
      accuracy == null ? "" : `, ± ${formatNumber(accuracy, 2)} m`,
    ];
    const name = this.layers.length > 1 ? `${vis.short}: ` : "";
    return `${name}${latitude.toFixed(6)}, ${longitude.toFixed(6)}${more.join("")}`;
  }

  // Returns a loaded tile, or null after starting to load it.
  fetchTile({ z, x, y }) {
    const url = this.address.replace("{z}", z).replace("{x}", x).replace("{y}", y).replace("{s}", "a");
    const known = this.tiles.get(url);
    if (known) {
      this.tiles.delete(url);
      this.tiles.set(url, known);
      return known.complete && known.naturalWidth ? known : null;
    }
    const picture = new Image();
    picture.referrerPolicy = "no-referrer";
    picture.onload = () => this.app.scheduleDraw(this);
    picture.onerror = () => (this.missing = (this.missing ?? 0) + 1);
    picture.src = url;
    this.tiles.set(url, picture);
    if (this.tiles.size > TILES) this.tiles.delete(this.tiles.keys().next().value);
    return null;
  }

  // Returns the track point nearest to a position on the canvas, or null.
  pointUnder(px, py) {
    const { map } = this;
    if (!map) return null;
    const [x, y] = [map.x + px / map.px, map.y + py / map.px];
    let best = /** @type {{layer: any, i: number, d: number} | null} */ (null);
    for (const layer of this.visibleLayers) {
      const { track } = layer;
      const i = track ? nearestPoint(track, x, y, (best?.d ?? NEAR) / map.px) : -1;
      if (i >= 0) best = { layer, i, d: Math.hypot(track.x[i] - x, track.y[i] - y) * map.px };
    }
    return best;
  }

  showTipAt(px, py, clientX, clientY) {
    const found = this.pointUnder(px, py);
    this.canvas.style.cursor = found ? "pointer" : "";
    if (!found) {
      const { x, y, px: k } = this.map ?? { x: 0, y: 0, px: 256 };
      const [lat, lon] = [toLatitude(y + py / k), toLongitude(x + px / k)];
      const far = this.visibleLayers.find((l) => l.place)?.place;
      const metres = far && groundDistance([lat, lon], [far.latitude, far.longitude]);
      const away = far ? `${formatNumber(metres, 3)} m from the position at the cursor` : "";
      return showTip(this, [`${lat.toFixed(6)}, ${lon.toFixed(6)}`, ...(away ? [away] : [])], clientX, clientY);
    }
    const { layer, i } = found;
    const { t, x, y } = layer.track;
    const at =
      this.app.client.origin == null ? formatRelative(t[i]) : formatAbsolute(t[i], this.app.client.origin, 1);
    const place = `${toLatitude(y[i]).toFixed(6)}, ${toLongitude(x[i]).toFixed(6)}`;
    showTip(this, [layer.vis.name, `${at}  (${formatRelative(t[i])})`, place], clientX, clientY);
  }

  addListeners() {
    const { canvas } = this;
    /** @type {{x: number, y: number, map: any, far: boolean} | null} */
    let drag = null;
    const listenTo = (name, f, options) => canvas.addEventListener(name, f, options);
    listenTo("wheel", (e) => {
      e.preventDefault();
      this.zoomBy(e.deltaY > 0 ? 1 / 1.2 : 1.2, e.offsetX, e.offsetY);
    });
    listenTo("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      drag = { x: e.offsetX, y: e.offsetY, map: { ...this.map }, far: false };
    });
    listenTo("pointermove", (e) => {
      if (!drag) return this.showTipAt(e.offsetX, e.offsetY, e.clientX, e.clientY);
      const [dx, dy] = [e.offsetX - drag.x, e.offsetY - drag.y];
      drag.far ||= Math.hypot(dx, dy) > 3;
      if (!drag.far) return;
      const { x, y, px } = drag.map;
      this.setView({ x: x - dx / px, y: y - dy / px, px });
    });
    listenTo("pointerup", (e) => {
      const found = drag && !drag.far && this.pointUnder(e.offsetX, e.offsetY);
      drag = null;
      if (found)
        this.app.time.dispatch({ type: "nudge", by: found.layer.track.t[found.i] - this.app.time.get().cursor });
    });
    listenTo("pointerleave", () => showTip(this, []));
    listenTo("dblclick", () => this.showAll());
    listenTo("keydown", (e) => {
      const move = { ArrowLeft: [-60, 0], ArrowRight: [60, 0], ArrowUp: [0, -60], ArrowDown: [0, 60] }[e.key];
      const { clientWidth: w, clientHeight: h } = this.el;
      if (e.ctrlKey || e.altKey || !this.map) return;
      const { x, y, px } = this.map;
      if (move) this.setView({ x: x + move[0] / px, y: y + move[1] / px, px });
      else if (e.key === "+" || e.key === "-") this.zoomBy(e.key === "+" ? 1.5 : 1 / 1.5, w / 2, h / 2);
      else if (e.key === "0") this.showAll();
      else return;
      e.preventDefault();
      e.stopPropagation();
    });
  }

  showAll() {
    this.moved = false;
    this.fitTracks();
    this.app.scheduleDraw(this);
  }

  zoomBy(by, px, py) {
    if (!this.map) return;
    const next = Math.min(Math.max(this.map.px * by, FAR_OUT), CLOSE);
    const [x, y] = [this.map.x + px / this.map.px, this.map.y + py / this.map.px];
    this.setView({ px: next, x: x - px / next, y: y - py / next });
  }

  setView(map) {
    this.map = map;
    this.moved = true;
    this.app.scheduleDraw(this);
  }

  // Redraws when the cursor has passed another point of a track.
  cursorMoved() {
    const { cursor } = this.app.time.get();
    const passed = this.layers.map((l) => (l.track ? countUntil(l.track, cursor) : 0)).join();
    if (passed === this.passed) return;
    this.passed = passed;
    this.app.scheduleDraw(this);
  }

  themeChanged() {
    this.app.scheduleDraw(this);
  }

  destroy() {
    this.observer.disconnect();
    showTip(this, []);
    for (const l of this.layers) this.closeLayer(l);
  }
}
