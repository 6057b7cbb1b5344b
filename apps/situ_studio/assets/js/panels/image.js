// A 2D panel: a picture, and what other streams have to show over it.

import { tip } from "../page/tip.js";
import { visualizers } from "../visualizers/index.js";
import { plugged } from "../plugins/plugged.js";
import { mapping } from "../visualizers/shapes.js";
import { PanZoom } from "./pan_zoom.js";

export class ImagePanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("image-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.info = el.appendChild(document.createElement("div"));
    this.info.className = "cell-info";
    this.layers = [];
    // who annotates boxes and points draws them here; else the picture is moved
    this.canvas.addEventListener("pointerdown", (e) => {
      if (this.app.annotation?.spatial.down(e, this)) e.stopImmediatePropagation();
    });
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
      const key = JSON.stringify([vis.viz, vis.stream, vis.path, vis.asked, vis.script?.url]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    for (const l of this.layers) l.drawer.restyle(l, () => this.app.schedule(this));
    this.app.schedule(this);
  }

  openLayer(key, vis) {
    const drawer = vis.script ? plugged : (visualizers.get(vis.draw) ?? visualizers.get("image"));
    const layer = { key, vis, drawer };
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    const accept = (frame) => layer.drawer.accept(layer, frame, () => this.app.schedule(this));
    layer.channel = this.app.client.open(spec, accept, { instant: true });
    return layer;
  }

  closeLayer(l) {
    this.app.client.close(l.channel);
    l.drawer.close(l);
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
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
    const classes = this.layers.find((l) => l.masks?.classes)?.masks.classes;
    const width = base?.width ?? shapes?.[0] ?? classes?.width ?? 640,
      height = base?.height ?? shapes?.[1] ?? classes?.height ?? 480;
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    const { zoom } = this.mouse;
    const k = Math.min(w / width, h / height) * zoom.k;
    return { k, x: (w - width * k) / 2 + zoom.x, y: (h - height * k) / 2 + zoom.y, width, height };
  }

  // Shapes over a mirrored picture are mirrored with it.
  map() {
    return mapping(this.fit(), this.base()?.vis.props?.flip === true);
  }

  // On the screen, or on what takes the same drawing (`page/vector.js`).
  render(ctx = this.canvas.getContext("2d")) {
    const f = this.fit(),
      map = this.map();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.imageSmoothingEnabled = f.k < 3;
    const shown = this.layers.filter((l) => l.vis.props?.visible !== false);
    const scene = { fit: f, map, width: w, height: h };
    // pictures lie below what is drawn over them
    for (const l of shown) if (l.picture) l.drawer.draw(ctx, l, scene);
    for (const l of shown) if (!l.picture) l.drawer.draw(ctx, l, scene);
    for (const l of shown) l.drawer.finish?.(ctx, l, scene);
    this.app.annotation?.spatial.draw(ctx, this);
    this.point();
    this.drawn = (this.drawn ?? 0) + 1;
    const base = this.base();
    // not on the panel's element: a diff takes away what the server did not write there
    if (base) this.canvas.dataset.at = String(base.at);
    else delete this.canvas.dataset.at;
  }

  // The value under the mouse, beside it; size, age and value of the picture in the corner.
  point() {
    const size = this.fit();
    for (const l of this.layers) l.size = size;
    const at = this.mouse.pointer && this.map().back(...this.mouse.pointer);
    this.note(at);
    const { k } = size;
    const found = at
      ? this.layers.flatMap((l) => (l.vis.props?.visible !== false ? l.drawer.under(l, ...at, k) : []))
      : [];
    const box = this.canvas.getBoundingClientRect();
    tip(this, found, ...(at ? [box.left + this.mouse.pointer[0], box.top + this.mouse.pointer[1]] : []));
  }

  note(at) {
    const error = this.layers.find((l) => l.error)?.error;
    const base = this.base();
    let text = error ?? "";
    if (!error && base) text = [...base.drawer.facts(base, this.app.time.get().cursor, at)].join("   ");
    else if (!error && this.layers.length)
      text = this.layers.some((l) => l.shapes || l.masks) ? "" : "no picture at the cursor";
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", !!error);
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
