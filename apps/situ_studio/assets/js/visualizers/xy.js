// Plots streams over each other: the first stream of the panel is x, the others are y. Each message of y in the view
// is a dot at the value of x at that time; the dot at the cursor is marked.

import { FONT, themeColors, seriesColor } from "../page/theme.js";
import { axisNumber, formatNumber, paddedRange, valueTicks } from "../page/number_text.js";

const EDGE = { left: 52, right: 12, top: 22, bottom: 26 };

// Returns triples [t, x, y] for the times of y in the view at which x is known; x holds until its next message is
// due. Pure.
export function pairValues(x, y, [from, to]) {
  const out = [];
  if (!x?.length || !y?.length) return out;
  for (let i = Math.max(y.indexAt(from), 0); i < y.length && y.t[i] <= to; i++) {
    const k = x.indexAt(y.t[i]);
    if (y.t[i] < from || k < 0 || y.t[i] - x.t[k] > x.gapThreshold(k)) continue;
    if (Number.isFinite(x.last[k]) && Number.isFinite(y.last[i])) out.push([y.t[i], x.last[k], y.last[i]]);
  }
  return out;
}

export class XYPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    this.windowed = true;
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
      const layer = old.get(key) ?? { key, channel: this.openChannel(vis) };
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.app.client.closeChannel(l.channel);
    this.app.scheduleDraw(this);
  }

  openChannel({ stream, viz, path }) {
    const widthInPixels = () => Math.max(this.el.clientWidth, 0);
    return this.app.client.openChannel({ stream, viz, path }, () => this.app.scheduleDraw(this), {
      px: widthInPixels,
    });
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.client.pump();
    this.app.scheduleDraw(this);
  }

  // Returns each stream of y with its dots in the view.
  dotClouds() {
    const { view } = this.app.time.get();
    const [x, ...ys] = this.layers.filter((l) => l.vis.props?.visible !== false || l.index === 0);
    return ys.map((l) => ({ l, dots: pairValues(x.channel.series, l.channel.series, view) }));
  }

  // Draws on the screen, or on another context such as `page/svg_context.js`.
  render(ctx = this.canvas.getContext("2d")) {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.font = FONT;
    const clouds = this.dotClouds();
    const all = clouds.flatMap((c) => c.dots);
    this.dots = all.length;
    if (!all.length) return this.drawNote(ctx);
    const valueSpan = (k) => {
      let lo = Infinity,
        hi = -Infinity;
      for (const d of all) [lo, hi] = [Math.min(lo, d[k]), Math.max(hi, d[k])];
      return paddedRange([[lo, hi]]);
    };
    const [xs, ys] = [valueSpan(1), valueSpan(2)];
    const box = { l: EDGE.left, r: w - EDGE.right, t: EDGE.top, b: h - EDGE.bottom };
    const xToPixels = (v) => box.l + ((v - xs[0]) / (xs[1] - xs[0])) * (box.r - box.l);
    const yToPixels = (v) => box.b - ((v - ys[0]) / (ys[1] - ys[0])) * (box.b - box.t);
    this.drawAxes(ctx, box, xs, ys, xToPixels, yToPixels);
    const { cursor } = this.app.time.get();
    for (const { l, dots } of clouds) {
      ctx.fillStyle = seriesColor(l.vis.props?.color, l.vis.color ?? l.index);
      ctx.globalAlpha = dots.length > 2000 ? 0.5 : 0.8;
      for (const [, a, b] of dots) ctx.fillRect(xToPixels(a) - 1, yToPixels(b) - 1, 2, 2);
      ctx.globalAlpha = 1;
      const now = dots.findLast(([t]) => t <= cursor);
      if (now) this.markCursor(ctx, xToPixels(now[1]), yToPixels(now[2]), now, box);
    }
    this.drawn = (this.drawn ?? 0) + 1;
  }

  drawAxes(ctx, box, xs, ys, x, y) {
    const t = themeColors();
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

  markCursor(ctx, px, py, [, a, b], box) {
    const t = themeColors();
    ctx.strokeStyle = t.cursor;
    ctx.lineWidth = 1.5;
    ctx.beginPath();
    ctx.arc(px, py, 5, 0, 2 * Math.PI);
    ctx.stroke();
    ctx.fillStyle = t.cursor;
    const text = `${formatNumber(a, 4)}, ${formatNumber(b, 4)}`;
    const left = px + 8 + ctx.measureText(text).width > box.r;
    ctx.textAlign = left ? "right" : "left";
    ctx.fillText(text, px + (left ? -8 : 8), Math.max(py - 6, box.t + 8));
    ctx.textAlign = "left";
  }

  drawNote(ctx) {
    ctx.fillStyle = themeColors().dim;
    const error = this.layers.find((l) => l.channel.error)?.channel.error;
    const text =
      this.layers.length < 2 ? "Drag a second stream here to plot it over this one" : "nothing in the view";
    ctx.fillText(error ?? text, 12, 24);
  }

  cursorMoved() {
    this.app.scheduleDraw(this);
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    for (const l of this.layers) this.app.client.closeChannel(l.channel);
  }
}
