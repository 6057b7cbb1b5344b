// A chart of the message at the cursor: histograms, scores by name, one or several lists of numbers.

import { KIND } from "../data/frames.js";
import { FONT, themeColors, seriesColor } from "../page/theme.js";
import { drawChart } from "./chart.js";

export class BarsPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("chart-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path, vis.asked]) : "";
    this.vis = vis;
    if (key === this.key) return this.app.scheduleDraw(this);
    this.key = key;
    this.app.client.closeChannel(this.channel);
    this.series = [];
    this.channel = vis
      ? this.app.client.openChannel(
          { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} },
          (f) => this.acceptFrame(f),
          { instant: true },
        )
      : null;
  }

  acceptFrame(f) {
    this.series = f.kind === KIND.json ? f.value.series : [];
    this.note = f.kind === KIND.error ? f.message : f.kind === KIND.none ? "no message at the cursor" : null;
    this.app.scheduleDraw(this);
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.scheduleDraw(this);
  }

  // Draws on the screen, or on another context such as `page/svg_context.js`.
  render(ctx = this.canvas.getContext("2d")) {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.font = FONT;
    if (!this.series.length) {
      ctx.fillStyle = themeColors().dim;
      ctx.fillText(this.note ?? "", 12, 24);
      return;
    }
    const { props = {}, color = 0 } = this.vis;
    const series = this.series.map(([name, rows], i) => ({
      name,
      rows,
      color: seriesColor(i ? null : props.color, color + i),
    }));
    drawChart(ctx, { series, w, h, props });
    this.drawn = (this.drawn ?? 0) + 1;
  }

  cursorMoved() {}

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.client.closeChannel(this.channel);
  }
}
