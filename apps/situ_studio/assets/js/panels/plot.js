// A timeline panel with a value axis: several streams over one another, each drawn by its visualizer in the draw hook
// of uPlot, which keeps scales, axes and grid.

import uPlot from "uplot";
import { GUTTER, FONT, theme, seriesColor, keyIndex } from "../page/theme.js";
import { rulerTicks } from "../time/clock.js";
import { axisNumber, fraction, valueTicks, paddedRange, tickCount } from "../page/number_text.js";
import { Legend } from "./legend.js";
import { brackets } from "../visualizers/paint.js";
import { visualizers } from "../visualizers/index.js";

// Room above the signals for their names and values.
const LEGEND = 22;
export class PlotPanel {
  // app: {time, client, schedule}; config: {vis: [{id, draw, stream, name, props}], axis: {mode, min, max}}
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("plot");
    this.body = el.appendChild(document.createElement("div"));
    this.body.className = "plot-body";
    this.legend = new Legend(this);
    this.layers = [];
    this.y = [0, 1];
    this.size = [0, 0];
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    this.config = config;
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.viz, vis.stream, vis.path, vis.asked]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    this.legend.forget();
    this.legend.build();
    this.app.schedule(this);
  }

  openLayer(key, vis) {
    const px = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    const changed = () => this.app.schedule(this);
    const channel = this.app.client.open(spec, changed, { px });
    const value = this.app.client.open(spec, changed, { value: true });
    const drawer = visualizers.get(vis.draw) ?? visualizers.get("line");
    // what takes its time to be made asks to be drawn by itself
    return { key, channel, value, vis, drawer, redraw: () => this.app.schedule(this) };
  }

  closeLayer(layer) {
    this.app.client.close(layer.channel);
    this.app.client.close(layer.value);
  }

  // The least difference that the text of a value must show at row `i` of an entry: a thousandth of the axis, or less
  // where the values around the row are closer.
  resolution(entry, i) {
    const { drawer } = entry.layer;
    const [lo, hi] = this.own ? paddedRange([drawer.extent(entry, this.app.time.get().view)]) : this.y;
    const found = [hi / 1000 - lo / 1000, entry.series?.spread?.(i)].filter((d) => d > 0);
    return found.length ? Math.min(...found) : 0;
  }

  // The drawn lines: one entry for each layer, or for each key of a stream of maps.
  lines() {
    return this.layers.flatMap((l) => l.drawer.entries(l));
  }

  color({ layer, name }, nth) {
    const own = layer.vis.color ?? layer.index;
    return seriesColor(layer.vis.props?.color, name === "" ? own : keyIndex(name, own + nth));
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h || (w === this.size[0] && h === this.size[1])) return;
    this.size = [w, h];
    if (!this.plot) this.build(w, h);
    else this.plot.setSize({ width: w, height: h });
    this.legend.more();
    this.app.client.pump();
    this.app.schedule(this);
  }

  build(width, height) {
    const grid = () => ({ stroke: () => theme().grid, width: 1 });
    // uPlot draws no axis whose steps are not in its own table; ours are those of `splits`
    const incrs = (_u, _i, lo, hi) => [Math.max(hi - lo, 5)];
    const options = {
      width,
      height,
      pxAlign: false,
      padding: [LEGEND, GUTTER.right, 6, 0],
      cursor: { show: false },
      legend: { show: false },
      select: { show: false },
      scales: {
        x: { time: false, auto: false, range: () => this.app.time.get().view },
        // uPlot gets positions from 0 to 1, since the difference of the ends of our range may overflow.
        y: { auto: false, range: () => [0, 1] },
      },
      series: [{}, { paths: () => null, points: { show: false } }],
      axes: [
        {
          size: 0,
          incrs,
          ticks: { show: false },
          grid: grid(),
          values: () => [],
          splits: (u, _i, lo, hi) => this.grid([lo, hi], u.width - GUTTER.left - GUTTER.right),
        },
        {
          size: () => GUTTER.left,
          incrs,
          gap: 6,
          font: FONT,
          stroke: () => theme().axis,
          ticks: { show: false },
          grid: grid(),
          splits: (u) => this.ticks(u.height).map((v) => fraction(v, ...this.y)),
          values: (u) => this.labels(this.ticks(u.height)),
        },
      ],
      hooks: { draw: [(u) => this.draw(u)] },
    };
    this.plot = new uPlot(
      options,
      [
        [0, 1],
        [null, null],
      ],
      this.body,
    );
  }

  // The times of the lines across, which are those of the ruler.
  grid(view, px) {
    return rulerTicks(view, px, this.app.client.origin).at;
  }

  range(view) {
    const axis = this.config.axis ?? {};
    if (axis.mode === "fixed" && axis.max > axis.min) return [axis.min, axis.max];
    // each line from its own least to its own greatest value: 0 and 1 here
    if (this.own) return [0, 1];
    const [lo, hi] = paddedRange(this.lines().map((e) => e.layer.drawer.extent(e, view)));
    if (!this.layers.length || !this.layers.every((l) => l.drawer.symmetric)) return [lo, hi];
    const m = Math.max(Math.abs(lo), Math.abs(hi), 1e-3);
    return [-m, m];
  }

  get own() {
    return this.config.axis?.mode === "own";
  }

  // The height of a value: on the panel's axis, or on that of the line alone.
  heights(entry, view, y) {
    const [lo, hi] = this.own ? paddedRange([entry.layer.drawer.extent(entry, view)]) : [0, 1];
    return this.own ? (v) => y(fraction(v, lo, hi)) : y;
  }

  ticks(height) {
    return valueTicks(...this.y, tickCount(height - LEGEND));
  }

  // The numbers beside the axis; none before there is anything to measure.
  labels(at) {
    const step = at.length > 1 ? at[1] - at[0] : 0;
    const texts = at.map((v) => (this.loading || this.own ? "" : axisNumber(v, step)));
    this.app.gutter.need(this, texts);
    return texts;
  }

  // Called once per picture, at most, when something this panel shows has changed.
  render() {
    if (!this.plot) return;
    this.loading =
      this.layers.some((l) => !l.channel.held && !l.channel.error) && !this.lines().some((e) => e.series.length);
    this.el.classList.toggle("loading", this.loading);
    const view = this.app.time.get().view;
    this.legend.build();
    this.y = this.range(view);
    this.plot.batch(() => {
      this.plot.setScale("x", { min: view[0], max: view[1] });
      this.plot.setScale("y", { min: 0, max: 1 });
    });
    this.plot.redraw(false, true);
    this.legend.values();
  }

  draw(u) {
    this.paint(u.ctx, u.bbox, devicePixelRatio);
    this.drawn = (this.drawn ?? 0) + 1;
  }

  // The panel as a drawing by itself: what uPlot draws on the screen, the axis and the grid, is drawn here.
  vector(ctx) {
    const [w, h] = this.size;
    const box = { left: GUTTER.left, top: LEGEND, width: w - GUTTER.left - GUTTER.right, height: h - LEGEND - 6 };
    const t = theme();
    const [lo, hi] = this.y;
    ctx.font = FONT;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    const ticks = this.ticks(h);
    for (const v of ticks) {
      const at = box.top + box.height - fraction(v, lo, hi) * box.height;
      ctx.fillStyle = t.grid;
      ctx.fillRect(box.left, at - 0.5, box.width, 1);
      ctx.fillStyle = t.axis;
      if (!this.own) ctx.fillText(axisNumber(v, ticks[1] - ticks[0]), box.left - 6, at);
    }
    const view = this.app.time.get().view;
    ctx.fillStyle = t.grid;
    for (const at of this.grid(view, box.width)) {
      ctx.fillRect(box.left + ((at - view[0]) / (view[1] - view[0])) * box.width - 0.5, box.top, 1, box.height);
    }
    ctx.textAlign = "left";
    this.paint(ctx, box, 1);
  }

  paint(ctx, bbox, ratio) {
    const view = this.app.time.get().view;
    const kx = bbox.width / (view[1] - view[0]);
    const x = (t) => bbox.left + (t - view[0]) * kx;
    const y = (v) => bbox.top + bbox.height - fraction(v, ...this.y) * bbox.height;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    this.lines().forEach((e, i) => {
      const { props = {} } = e.layer.vis;
      const scene = { view, x, y: this.heights(e, view, y), ratio, props, color: this.color(e, i) };
      if (props.visible !== false) e.layer.drawer.draw(ctx, e, scene);
    });
    for (const l of this.layers) {
      const ends = l.vis.props?.visible !== false && this.app.client.ends(l.vis.ends);
      if (ends) {
        const color = this.color({ layer: l, name: "" }, 0);
        brackets(ctx, ends, x, bbox.top, bbox.top + bbox.height, { color, ratio });
      }
    }
    this.cover(ctx, bbox, y);
    ctx.restore();
  }

  // Values beyond the threshold are covered, so that the rest stands out.
  cover(ctx, bbox, y) {
    const { side, value } = this.config.threshold ?? {};
    if (!side || this.own) return;
    const at = Math.min(Math.max(y(value), bbox.top), bbox.top + bbox.height);
    ctx.fillStyle = theme().panel;
    ctx.globalAlpha = 0.75;
    if (side === "below") ctx.fillRect(bbox.left, at, bbox.width, bbox.top + bbox.height - at);
    else ctx.fillRect(bbox.left, bbox.top, bbox.width, at - bbox.top);
    ctx.globalAlpha = 1;
    ctx.fillStyle = theme().warn;
    ctx.fillRect(bbox.left, at, bbox.width, devicePixelRatio);
  }

  cursorMoved() {
    this.legend.values();
  }

  themeChanged() {
    this.legend.forget();
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.gutter.need(this, null);
    for (const l of this.layers) this.closeLayer(l);
    this.plot?.destroy();
  }
}
