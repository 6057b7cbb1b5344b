// Numbers over one another: the first stream of the panel is x, the others are y. A dot stands for a message of y in
// the view, at the value that x has then; the one at the cursor is marked.

import { FONT, theme, seriesColor } from "../page/theme.js";
import { axisNumber, number, paddedRange, valueTicks } from "../page/number_text.js";

const EDGE = { left: 52, right: 12, top: 22, bottom: 26 };

// Pairs [t, x, y] of the times of y within the view at which x is known; x holds until its next message is due. Pure.
export function pairs(x, y, [from, to]) {
  const out = [];
  if (!x?.length || !y?.length) return out;
  for (let i = Math.max(y.at(from), 0); i < y.length && y.t[i] <= to; i++) {
    const k = x.at(y.t[i]);
    if (y.t[i] < from || k < 0 || y.t[i] - x.t[k] > x.patience(k)) continue;
    if (Number.isFinite(x.last[k]) && Number.isFinite(y.last[i])) out.push([y.t[i], x.last[k], y.last[i]]);
  }
  return out;
}

export class XYPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app, windowed: true });
    el.classList.add("xy-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.layers = [];
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.stream, vis.path]);
      const layer = old.get(key) ?? { key, channel: this.open(vis) };
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.app.client.close(l.channel);
    this.app.schedule(this);
  }

  open({ stream, viz, path }) {
    const px = () => Math.max(this.el.clientWidth, 0);
    return this.app.client.open({ stream, viz, path }, () => this.app.schedule(this), { px });
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.client.pump();
    this.app.schedule(this);
  }

  // Each stream of y with its dots in the view.
  clouds() {
    const { view } = this.app.time.get();
    const [x, ...ys] = this.layers.filter((l) => l.vis.props?.visible !== false || l.index === 0);
    return ys.map((l) => ({ l, dots: pairs(x.channel.series, l.channel.series, view) }));
  }

  // On the screen, or on what takes the same drawing (`page/vector.js`).
  render(ctx = this.canvas.getContext("2d")) {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.font = FONT;
    const clouds = this.clouds();
    const all = clouds.flatMap((c) => c.dots);
    this.dots = all.length;
    if (!all.length) return this.note(ctx);
    const span = (k) => {
      let lo = Infinity,
        hi = -Infinity;
      for (const d of all) [lo, hi] = [Math.min(lo, d[k]), Math.max(hi, d[k])];
      return paddedRange([[lo, hi]]);
    };
    const [xs, ys] = [span(1), span(2)];
    const box = { l: EDGE.left, r: w - EDGE.right, t: EDGE.top, b: h - EDGE.bottom };
    const x = (v) => box.l + ((v - xs[0]) / (xs[1] - xs[0])) * (box.r - box.l);
    const y = (v) => box.b - ((v - ys[0]) / (ys[1] - ys[0])) * (box.b - box.t);
    this.axes(ctx, box, xs, ys, x, y);
    const { cursor } = this.app.time.get();
    for (const { l, dots } of clouds) {
      ctx.fillStyle = seriesColor(l.vis.props?.color, l.vis.color ?? l.index);
      ctx.globalAlpha = dots.length > 2000 ? 0.5 : 0.8;
      for (const [, a, b] of dots) ctx.fillRect(x(a) - 1, y(b) - 1, 2, 2);
      ctx.globalAlpha = 1;
      const now = dots.findLast(([t]) => t <= cursor);
      if (now) this.mark(ctx, x(now[1]), y(now[2]), now, box);
    }
    this.drawn = (this.drawn ?? 0) + 1;
  }

  axes(ctx, box, xs, ys, x, y) {
    const t = theme();
    ctx.textAlign = "center";
    for (const v of valueTicks(...xs, Math.max(2, Math.floor((box.r - box.l) / 70)))) {
      ctx.fillStyle = t.grid;
      ctx.fillRect(Math.round(x(v)), box.t, 1, box.b - box.t);
      ctx.fillStyle = t.axis;
      ctx.fillText(axisNumber(v), x(v), box.b + 15);
    }
    ctx.textAlign = "right";
    for (const v of valueTicks(...ys, Math.max(2, Math.floor((box.b - box.t) / 34)))) {
      ctx.fillStyle = t.grid;
      ctx.fillRect(box.l, Math.round(y(v)), box.r - box.l, 1);
      ctx.fillStyle = t.axis;
      ctx.fillText(axisNumber(v), box.l - 6, y(v) + 4);
    }
    ctx.textAlign = "left";
    const [first, ...rest] = this.layers.map((l) => l.vis.short ?? l.vis.name);
    ctx.fillStyle = t.dim;
    ctx.fillText(`${rest.join(", ")} over ${first}`, box.l, 14);
  }

  mark(ctx, px, py, [, a, b], box) {
    const t = theme();
    ctx.strokeStyle = t.cursor;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.arc(px, py, 5, 0, 2 * Math.PI);
    ctx.stroke();
    ctx.fillStyle = t.cursor;
    const text = `${number(a, 4)}, ${number(b, 4)}`;
    const left = px + 8 + ctx.measureText(text).width > box.r;
    ctx.textAlign = left ? "right" : "left";
    ctx.fillText(text, px + (left ? -8 : 8), Math.max(py - 6, box.t + 8));
    ctx.textAlign = "left";
  }

  note(ctx) {
    ctx.fillStyle = theme().dim;
    const error = this.layers.find((l) => l.channel.error)?.channel.error;
    const text =
      this.layers.length < 2 ? "Drag a second stream here: it is drawn over this one" : "nothing in the view";
    ctx.fillText(error ?? text, 12, 24);
  }

  cursorMoved() {
    this.app.schedule(this);
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    for (const l of this.layers) this.app.client.close(l.channel);
  }
}
