// A 2D panel: a picture, and rectangles, points, lines and texts of other streams over it.

import { KIND } from "./wire.js";
import { bitmap } from "./pixels.js";
import { look, distance } from "./depth.js";
import { drawScale } from "./color_scale.js";
import { mapping, drawShapes, shapesAt } from "./shapes.js";
import { PanZoom } from "./pan_zoom.js";
import { duration } from "./time_text.js";
import { tip } from "./tip.js";

// A picture that is older than this at the cursor says so.
const OLD = 1e9;

export class ImageCell {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("image-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.info = el.appendChild(document.createElement("div"));
    this.info.className = "cell-info";
    this.layers = [];
    this.mouse = new PanZoom(this.canvas, {
      fit: () => this.fit(),
      changed: () => this.app.schedule(this),
      pointed: () => this.point(),
    });
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    this.config = config;
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.draw, vis.stream, vis.path]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    for (const l of this.layers) this.recolor(l);
    this.app.schedule(this);
  }

  openLayer(key, vis) {
    const layer = { key, vis };
    const spec = { stream: vis.stream, draw: vis.draw, path: vis.path };
    layer.channel = this.app.client.open(spec, (f) => this.accept(layer, f), { instant: true });
    return layer;
  }

  closeLayer(l) {
    this.app.client.close(l.channel);
    l.picture?.image.close();
  }

  // Depth that is there already is coloured anew when its properties change.
  recolor(layer) {
    const style = layer.vis.draw === "depth" ? JSON.stringify(layer.vis.props ?? {}) : null;
    if (layer.style !== undefined && layer.style !== style && layer.frame) this.decode(layer, layer.frame);
    layer.style = style;
  }

  accept(layer, f) {
    layer.error = f.kind === KIND.error ? f.message : null;
    if (f.kind === KIND.image) return this.decode(layer, f);
    layer.generation = (layer.generation ?? 0) + 1;
    layer.frame = null;
    if (f.kind === KIND.json) layer.shapes = f.value;
    else {
      layer.shapes = null;
      layer.picture?.image.close();
      layer.picture = null;
    }
    this.app.schedule(this);
  }

  // One picture is decoded at a time; of those that arrive meanwhile only the newest is kept.
  async decode(layer, f) {
    layer.frame = layer.vis.draw === "depth" ? f : null;
    if (layer.decoding) {
      layer.waiting = f;
      return;
    }
    layer.decoding = true;
    const generation = layer.generation ?? 0;
    try {
      const picture = await bitmap(f, layer.vis.draw === "depth" ? look(layer.vis.props) : null);
      if (generation === (layer.generation ?? 0)) {
        layer.picture?.image.close();
        layer.picture = picture;
        layer.at = f.at;
      } else picture.image.close();
    } catch (error) {
      layer.error = `picture cannot be shown: ${error.message}`;
    }
    layer.decoding = false;
    const next = layer.waiting;
    layer.waiting = null;
    if (next) this.decode(layer, next);
    this.app.schedule(this);
  }

  resize() {
    const w = this.el.clientWidth, h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.schedule(this);
  }

  base() {
    return this.layers.find((l) => l.picture);
  }

  // Canvas pixels per picture pixel, and where the picture's corner is: letterboxed, then zoomed.
  fit() {
    const base = this.base()?.picture;
    const shapes = this.layers.find((l) => l.shapes?.size)?.shapes.size;
    const width = base?.width ?? shapes?.[0] ?? 640, height = base?.height ?? shapes?.[1] ?? 480;
    const w = this.el.clientWidth, h = this.el.clientHeight;
    const { zoom } = this.mouse;
    const k = Math.min(w / width, h / height) * zoom.k;
    return { k, x: (w - width * k) / 2 + zoom.x, y: (h - height * k) / 2 + zoom.y, width, height };
  }

  // What lies over a mirrored picture is mirrored with it.
  map() {
    return mapping(this.fit(), this.base()?.vis.props?.flip === true);
  }

  render() {
    const ctx = this.canvas.getContext("2d");
    const f = this.fit(), map = this.map();
    const w = this.el.clientWidth, h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.imageSmoothingEnabled = f.k < 3;
    const shown = this.layers.filter((l) => l.vis.props?.visible !== false);
    for (const l of shown) if (l.picture) this.picture(ctx, l, f);
    for (const l of shown) if (l.shapes) drawShapes(ctx, l, map);
    const depth = shown.find((l) => l.picture?.range && l.vis.props?.scale !== false);
    if (depth) drawScale(ctx, w, h, depth.picture);
    this.point();
    this.drawn = (this.drawn ?? 0) + 1;
    const base = this.base();
    // not on the panel's element: a diff takes away what the server did not write there
    if (base) this.canvas.dataset.at = String(base.at);
    else delete this.canvas.dataset.at;
  }

  picture(ctx, { picture, vis }, f) {
    ctx.save();
    if (vis.props?.flip) {
      ctx.translate(f.x + picture.width * f.k, f.y);
      ctx.scale(-1, 1);
    } else ctx.translate(f.x, f.y);
    ctx.drawImage(picture.image, 0, 0, picture.width * f.k, picture.height * f.k);
    ctx.restore();
  }

  // What lies under the mouse, beside it; size, age and value of the picture in the corner.
  point() {
    const at = this.mouse.pointer && this.map().back(...this.mouse.pointer);
    this.note(at);
    const { k } = this.fit();
    const found = at
      ? this.layers.flatMap((l) => (l.shapes && l.vis.props?.visible !== false ? shapesAt(l.shapes, ...at, k) : []))
      : [];
    const box = this.canvas.getBoundingClientRect();
    tip(this, found, ...(at ? [box.left + this.mouse.pointer[0], box.top + this.mouse.pointer[1]] : []));
  }

  note(at) {
    const error = this.layers.find((l) => l.error)?.error;
    const base = this.base();
    let text = error ?? "";
    if (!error && base) text = [...this.facts(base, at)].join("   ");
    else if (!error && this.layers.length) text = this.layers.some((l) => l.shapes) ? "" : "no picture at the cursor";
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", !!error);
  }

  *facts({ picture, at: time, vis }, at) {
    const { width, height, values, unit } = picture;
    yield `${width} × ${height}`;
    const age = this.app.time.get().cursor - time;
    if (age >= OLD) yield `${duration(age)} old`;
    const [x, y] = (at ?? []).map(Math.floor);
    if (!values || !(x >= 0 && y >= 0 && x < width && y < height)) return;
    const value = values[y * width + x];
    const none = vis.draw === "depth" && value === look(vis.props).invalid;
    yield `(${x}, ${y}) = ${value}${none ? ", no reading" : unit ? `, ${distance(value, unit)}` : ""}`;
  }

  cursorMoved() {
    this.point();
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    tip(this, []);
    for (const l of this.layers) this.closeLayer(l);
  }
}
