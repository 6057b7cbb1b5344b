// Bars of a message at the cursor: histograms, scores by name, lists of numbers.

import { KIND } from "../data/wire.js";
import { FONT, theme, seriesColor } from "../page/theme.js";
import { number, valueTicks } from "../page/number_text.js";

export class BarsPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("chart-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path]) : "";
    this.vis = vis;
    if (key === this.key) return this.app.schedule(this);
    this.key = key;
    this.app.client.close(this.channel);
    this.bars = [];
    this.channel = vis
      ? this.app.client.open({ stream: vis.stream, viz: vis.viz, path: vis.path }, (f) => this.accept(f), {
          instant: true,
        })
      : null;
  }

  accept(f) {
    this.bars = f.kind === KIND.json ? f.value.bars : [];
    this.note = f.kind === KIND.error ? f.message : f.kind === KIND.none ? "no message at the cursor" : null;
    this.app.schedule(this);
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.schedule(this);
  }

  // On the screen, or on what takes the same drawing (`page/vector.js`).
  render(ctx = this.canvas.getContext("2d")) {
    const c = theme();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.font = FONT;
    const bars = this.bars;
    if (!bars.length) {
      ctx.fillStyle = c.dim;
      ctx.fillText(this.note ?? "", 12, 24);
      return;
    }
    const box = { l: 52, t: 12, r: w - 12, b: h - 26 };
    const values = bars.map((b) => b[1]);
    const lo = Math.min(0, ...values),
      hi = Math.max(0, ...values) || 1;
    const y = (v) => box.b - ((v - lo) / (hi - lo || 1)) * (box.b - box.t);
    ctx.textAlign = "right";
    for (const t of valueTicks(lo, hi, Math.max(2, Math.floor(h / 50)))) {
      ctx.fillStyle = c.grid;
      ctx.fillRect(box.l, Math.round(y(t)), box.r - box.l, 1);
      ctx.fillStyle = c.axis;
      ctx.fillText(number(t), box.l - 6, y(t) + 4);
    }
    const step = (box.r - box.l) / bars.length;
    const gap = Math.min(step * 0.2, 8);
    ctx.textAlign = "center";
    const every = Math.ceil(48 / step);
    bars.forEach(([label, v], i) => {
      const x = box.l + i * step;
      ctx.fillStyle = seriesColor(this.vis.props?.color, this.vis.color ?? 0);
      ctx.fillRect(x + gap / 2, Math.min(y(v), y(0)), Math.max(step - gap, 1), Math.max(Math.abs(y(v) - y(0)), 1));
      if (i % every) return;
      ctx.fillStyle = c.axis;
      ctx.fillText(label.length > 12 ? label.slice(0, 11) + "…" : label, x + step / 2, h - 10);
    });
    ctx.textAlign = "left";
    this.drawn = (this.drawn ?? 0) + 1;
  }

  cursorMoved() {}

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.client.close(this.channel);
  }
}
