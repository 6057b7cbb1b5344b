// A 2D panel: a picture, and rectangles, points, lines and texts of other streams over it.

import { KIND } from "./wire.js";
import { bitmap } from "./pixels.js";
import { FONT, theme, seriesColor } from "./theme.js";
import { number } from "./number_text.js";

export class ImageCell {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("image-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.info = el.appendChild(document.createElement("div"));
    this.info.className = "cell-info";
    this.layers = [];
    this.zoom = { k: 1, x: 0, y: 0 };
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.gestures();
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

  accept(layer, f) {
    layer.error = f.kind === KIND.error ? f.message : null;
    if (f.kind === KIND.image) return this.decode(layer, f);
    layer.generation = (layer.generation ?? 0) + 1;
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
    if (layer.decoding) {
      layer.waiting = f;
      return;
    }
    layer.decoding = true;
    const generation = layer.generation ?? 0;
    try {
      const range = layer.vis.props?.range;
      const picture = await bitmap(f, Array.isArray(range) && range[1] > range[0] ? range : null);
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

  // Canvas pixels per picture pixel, and where the picture's corner is: letterboxed, then zoomed.
  fit() {
    const base = this.layers.find((l) => l.picture)?.picture;
    const shapes = this.layers.find((l) => l.shapes?.size)?.shapes.size;
    const width = base?.width ?? shapes?.[0] ?? 640, height = base?.height ?? shapes?.[1] ?? 480;
    const w = this.el.clientWidth, h = this.el.clientHeight;
    const k = Math.min(w / width, h / height) * this.zoom.k;
    return { k, x: (w - width * k) / 2 + this.zoom.x, y: (h - height * k) / 2 + this.zoom.y, width, height };
  }

  render() {
    const ctx = this.canvas.getContext("2d");
    const f = this.fit();
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, this.el.clientWidth, this.el.clientHeight);
    ctx.imageSmoothingEnabled = f.k < 3;
    for (const l of this.layers) {
      if (l.vis.props?.visible === false || !l.picture) continue;
      ctx.save();
      if (l.vis.props?.flip) {
        ctx.translate(f.x + l.picture.width * f.k, f.y);
        ctx.scale(-1, 1);
      } else ctx.translate(f.x, f.y);
      ctx.drawImage(l.picture.image, 0, 0, l.picture.width * f.k, l.picture.height * f.k);
      ctx.restore();
    }
    for (const l of this.layers) {
      if (l.vis.props?.visible !== false && l.shapes) this.shapes(ctx, l, f);
    }
    this.note();
    this.drawn = (this.drawn ?? 0) + 1;
    const base = this.layers.find((l) => l.picture);
    // not on the panel's element: a diff takes away what the server did not write there
    if (base) this.canvas.dataset.at = String(base.at);
    else delete this.canvas.dataset.at;
  }

  shapes(ctx, l, f) {
    const s = l.shapes;
    ctx.font = FONT;
    ctx.lineWidth = l.vis.props?.width ?? 2;
    const px = (x) => f.x + x * f.k, py = (y) => f.y + y * f.k;
    (s.rects ?? []).forEach(([x, y, w, h, label, score, id], i) => {
      const color = seriesColor(l.vis.props?.color, Number.isInteger(id) ? id : l.index + i);
      ctx.strokeStyle = color;
      ctx.strokeRect(px(x), py(y), w * f.k, h * f.k);
      const track = Number.isInteger(id) ? String(id) : null;
      const text = [label, track, score == null ? null : number(score, 2)].filter((p) => p != null && p !== "").join("  ");
      if (text && l.vis.props?.labels !== false) this.tag(ctx, text, px(x) - 1, py(y), color);
    });
    const color = seriesColor(l.vis.props?.color, l.index);
    ctx.strokeStyle = ctx.fillStyle = color;
    ctx.beginPath();
    for (const [a, b, c, d] of s.lines ?? []) {
      ctx.moveTo(px(a), py(b));
      ctx.lineTo(px(c), py(d));
    }
    ctx.stroke();
    const r = l.vis.props?.radius ?? ((s.points?.length ?? 0) > 100 ? 1.2 : 3);
    ctx.beginPath();
    for (const [x, y] of s.points ?? []) {
      ctx.moveTo(px(x) + r, py(y));
      ctx.arc(px(x), py(y), r, 0, 2 * Math.PI);
    }
    ctx.fill();
    for (const [x, y, label] of s.points ?? []) if (label) this.tag(ctx, label, px(x) + 5, py(y), color);
    (s.texts ?? []).forEach((text, i) => this.tag(ctx, text, f.x + 8, f.y + 26 + 22 * i, color));
  }

  tag(ctx, text, x, y, color) {
    const w = ctx.measureText(text).width + 10;
    const top = Math.max(y - 17, 0);
    ctx.fillStyle = color;
    ctx.fillRect(x, top, w, 17);
    ctx.fillStyle = theme().bg;
    ctx.textBaseline = "middle";
    ctx.fillText(text, x + 5, top + 9);
    ctx.textBaseline = "alphabetic";
  }

  note() {
    const error = this.layers.find((l) => l.error)?.error;
    const base = this.layers.find((l) => l.picture);
    let text = error ?? "";
    if (!error && base) {
      text = `${base.picture.width} × ${base.picture.height}`;
      if (this.pointer && base.picture.depth) {
        const f = this.fit();
        const x = Math.floor((this.pointer[0] - f.x) / f.k), y = Math.floor((this.pointer[1] - f.y) / f.k);
        if (x >= 0 && y >= 0 && x < f.width && y < f.height) {
          text += `   (${x}, ${y}) = ${base.picture.depth[y * f.width + x]}`;
        }
      }
    } else if (!error && this.layers.length) text = this.layers.some((l) => l.shapes) ? "" : "no picture at the cursor";
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", !!error);
  }

  gestures() {
    const c = this.canvas;
    c.addEventListener("wheel", (e) => {
      e.preventDefault();
      const factor = e.deltaY > 0 ? 1 / 1.1 : 1.1;
      const f = this.fit();
      const ix = (e.offsetX - f.x) / f.k, iy = (e.offsetY - f.y) / f.k;
      this.zoom.k = Math.min(Math.max(this.zoom.k * factor, 0.2), 60);
      const g = this.fit();
      this.zoom.x += e.offsetX - (g.x + ix * g.k);
      this.zoom.y += e.offsetY - (g.y + iy * g.k);
      this.app.schedule(this);
    }, { passive: false });
    c.addEventListener("pointerdown", (e) => {
      c.setPointerCapture(e.pointerId);
      this.drag = [e.offsetX - this.zoom.x, e.offsetY - this.zoom.y];
    });
    c.addEventListener("pointermove", (e) => {
      this.pointer = [e.offsetX, e.offsetY];
      if (this.drag) {
        this.zoom.x = e.offsetX - this.drag[0];
        this.zoom.y = e.offsetY - this.drag[1];
        this.app.schedule(this);
      } else this.note();
    });
    c.addEventListener("pointerup", () => (this.drag = null));
    c.addEventListener("pointerleave", () => (this.pointer = null));
    c.addEventListener("dblclick", () => {
      this.zoom = { k: 1, x: 0, y: 0 };
      this.app.schedule(this);
    });
  }

  cursorMoved() {}

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    for (const l of this.layers) this.closeLayer(l);
  }
}
