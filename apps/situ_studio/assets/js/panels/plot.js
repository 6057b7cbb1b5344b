// A timeline panel with a value axis. Its streams are drawn over one another by their visualizers in the draw hook
// of uPlot, which manages scales, axes and grid.

import uPlot from "uplot";
import { GUTTER, FONT, themeColors, seriesColor, keyIndex } from "../page/theme.js";
import { rulerTicks } from "../time/clock.js";
import { axisNumber, valueFraction, valueTicks, paddedRange, tickCount } from "../page/number_text.js";
import { Legend } from "./legend.js";
import { paintBrackets } from "../visualizers/paint.js";
import { getVisualizer } from "../visualizers/index.js";

// The space above the signals for their names and values.
const LEGEND = 22;
export class PlotPanel {
  // app: {time, client, schedule}; config: {vis: [{id, draw, stream, name, props}], axis: {mode, min, max}}
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
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
    this.legend.invalidate();
    this.legend.build();
    this.app.scheduleDraw(this);
  }

  openLayer(key, vis) {
    const widthInPixels = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    const scheduleDraw = () => this.app.scheduleDraw(this);
    const channel = this.app.client.openChannel(spec, scheduleDraw, { px: widthInPixels });
    const value = this.app.client.openChannel(spec, scheduleDraw, { value: true });
    const drawer = getVisualizer(vis.draw, "line");
    // drawings that are computed in the background request a redraw
    return { key, channel, value, vis, drawer, redraw: () => this.app.scheduleDraw(this) };
  }

  closeLayer(layer) {
    this.app.client.closeChannel(layer.channel);
    this.app.client.closeChannel(layer.value);
  }

  // Returns the smallest difference that the text of a value must show at row `i`: a thousandth of the axis, or less
  // if the values around the row are closer.
  valueResolution(entry, i) {
    const { drawer } = entry.layer;
    const [lo, hi] = this.hasOwnAxes ? paddedRange([drawer.valueExtent(entry, this.app.time.get().view)]) : this.y;
    const found = [hi / 1000 - lo / 1000, entry.series?.valueSpread?.(i)].filter((d) => d > 0);
    return found.length ? Math.min(...found) : 0;
  }

  // Lists the drawn lines: one for each layer, or for each key of a stream of maps.
  drawnLines() {
    return this.layers.flatMap((l) => l.drawer.lineEntries(l));
  }

  lineColor({ layer, name }, nth) {
    const own = layer.vis.color ?? layer.index;
    return seriesColor(layer.vis.props?.color, name === "" ? own : keyIndex(name, own + nth));
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h || (w === this.size[0] && h === this.size[1])) return;
    this.size = [w, h];
    if (!this.plot) this.buildPlot(w, h);
    else this.plot.setSize({ width: w, height: h });
    this.legend.showHiddenCount();
    this.app.client.pump();
    this.app.scheduleDraw(this);
  }

  buildPlot(width, height) {
    const gridStyle = () => ({ stroke: () => themeColors().grid, width: 1 });
    // uPlot only draws axes whose increments are in this list; `splits` determines the actual ones
    const incrs = (_u, _i, lo, hi) => [Math.max(hi - lo, 5)];
    /** @type {uPlot.Options} */
    const options = {
      width,
      height,
      pxAlign: false,
      padding: [LEGEND, GUTTER.right, 6, 0],
      cursor: { show: false },
      legend: { show: false },
      select: { show: false, left: 0, top: 0, width: 0, height: 0 },
      scales: {
        x: { time: false, auto: false, range: () => this.app.time.get().view },
        // uPlot gets positions from 0 to 1, since the difference of our range's ends may overflow.
        y: { auto: false, range: () => [0, 1] },
      },
      series: [{}, { paths: () => null, points: { show: false } }],
      axes: [
        {
          size: 0,
          incrs,
          ticks: { show: false },
          grid: gridStyle(),
          values: () => [],
          splits: (u, _i, lo, hi) => this.gridTimes([lo, hi], u.width - GUTTER.left - GUTTER.right),
        },
        {
          size: () => GUTTER.left,
          incrs,
          gap: 6,
          font: FONT,
          stroke: () => themeColors().axis,
          ticks: { show: false },
          grid: gridStyle(),
          splits: (u) => this.axisTicks(u.height).map((v) => valueFraction(v, ...this.y)),
          values: (u) => this.axisLabels(this.axisTicks(u.height)),
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

  // Returns the times of the vertical grid lines, which match the ruler.
  gridTimes(view, px) {
    return rulerTicks(view, px, this.app.client.origin).at;
  }

  valueRange(view) {
    const axis = this.config.axis ?? {};
    if (axis.mode === "fixed" && axis.max > axis.min) return [axis.min, axis.max];
    // each line is scaled to its own range, so the axis is 0 to 1
    if (this.hasOwnAxes) return [0, 1];
    const [lo, hi] = paddedRange(this.drawnLines().map((e) => e.layer.drawer.valueExtent(e, view)));
    if (!this.layers.length || !this.layers.every((l) => l.drawer.symmetric)) return [lo, hi];
    const m = Math.max(Math.abs(lo), Math.abs(hi), 1e-3);
    return [-m, m];
  }

  get hasOwnAxes() {
    return this.config.axis?.mode === "own";
  }

  // Returns the function from value to height: on the panel's axis, or on the line's own.
  heightScale(entry, view, y) {
    const [lo, hi] = this.hasOwnAxes ? paddedRange([entry.layer.drawer.valueExtent(entry, view)]) : [0, 1];
    return this.hasOwnAxes ? (v) => y(valueFraction(v, lo, hi)) : y;
  }

  axisTicks(height) {
    return valueTicks(...this.y, tickCount(height - LEGEND));
  }

  // Returns the axis labels; empty before there are data.
  axisLabels(at) {
    const step = at.length > 1 ? at[1] - at[0] : 0;
    const texts = at.map((v) => (this.loading || this.hasOwnAxes ? "" : axisNumber(v, step)));
    this.app.gutter.reserveRoom(this, texts);
    return texts;
  }

  // Called at most once per animation frame, after a change that affects this panel.
  render() {
    if (!this.plot) return;
    this.loading =
      this.layers.some((l) => !l.channel.held && !l.channel.error) && !this.drawnLines().some((e) => e.series.length);
    this.el.classList.toggle("loading", this.loading);
    const view = this.app.time.get().view;
    this.legend.build();
    this.y = this.valueRange(view);
    const { plot } = this;
    plot.batch(() => {
      plot.setScale("x", { min: view[0], max: view[1] });
      plot.setScale("y", { min: 0, max: 1 });
    });
    plot.redraw(false, true);
    this.legend.updateValues();
  }

  draw(u) {
    this.paintLines(u.ctx, u.bbox, devicePixelRatio);
    this.drawn = (this.drawn ?? 0) + 1;
  }

  // Draws the whole panel, including the axis and grid that uPlot draws on the screen.
  drawVector(ctx) {
    const [w, h] = this.size;
    const box = { left: GUTTER.left, top: LEGEND, width: w - GUTTER.left - GUTTER.right, height: h - LEGEND - 6 };
    const t = themeColors();
    const [lo, hi] = this.y;
    ctx.font = FONT;
    ctx.textAlign = "right";
    ctx.textBaseline = "middle";
    const ticks = this.axisTicks(h);
    for (const v of ticks) {
      const at = box.top + box.height - valueFraction(v, lo, hi) * box.height;
      ctx.fillStyle = t.grid;
      ctx.fillRect(box.left, at - 0.5, box.width, 1);
      ctx.fillStyle = t.axis;
      if (!this.hasOwnAxes) ctx.fillText(axisNumber(v, ticks[1] - ticks[0]), box.left - 6, at);
    }
    const view = this.app.time.get().view;
    ctx.fillStyle = t.grid;
    for (const at of this.gridTimes(view, box.width)) {
      ctx.fillRect(box.left + ((at - view[0]) / (view[1] - view[0])) * box.width - 0.5, box.top, 1, box.height);
    }
    ctx.textAlign = "left";
    this.paintLines(ctx, box, 1);
  }

  paintLines(ctx, bbox, ratio) {
    const view = this.app.time.get().view;
    const kx = bbox.width / (view[1] - view[0]);
    const timeToX = (t) => bbox.left + (t - view[0]) * kx;
    const valueToY = (v) => bbox.top + bbox.height - valueFraction(v, ...this.y) * bbox.height;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    this.drawnLines().forEach((e, i) => {
      const { props = {} } = e.layer.vis;
      const scene = {
        view,
        x: timeToX,
        y: this.heightScale(e, view, valueToY),
        ratio,
        props,
        color: this.lineColor(e, i),
      };
      if (props.visible !== false) e.layer.drawer.draw(ctx, e, scene);
    });
    for (const l of this.layers) {
      const ends = l.vis.props?.visible !== false && this.app.client.relativeEnds(l.vis.ends);
      if (ends) {
        const color = this.lineColor({ layer: l, name: "" }, 0);
        paintBrackets(ctx, ends, timeToX, bbox.top, bbox.top + bbox.height, { color, ratio });
      }
    }
    this.coverValues(ctx, bbox, valueToY);
    ctx.restore();
  }

  // Covers values beyond the threshold, so that the others stand out.
  coverValues(ctx, bbox, y) {
    const { side, value } = this.config.threshold ?? {};
    if (!side || this.hasOwnAxes) return;
    const at = Math.min(Math.max(y(value), bbox.top), bbox.top + bbox.height);
    ctx.fillStyle = themeColors().panel;
    ctx.globalAlpha = 0.75;
    if (side === "below") ctx.fillRect(bbox.left, at, bbox.width, bbox.top + bbox.height - at);
    else ctx.fillRect(bbox.left, bbox.top, bbox.width, at - bbox.top);
    ctx.globalAlpha = 1;
    ctx.fillStyle = themeColors().warn;
    ctx.fillRect(bbox.left, at, bbox.width, devicePixelRatio);
  }

  cursorMoved() {
    this.legend.updateValues();
  }

  themeChanged() {
    this.legend.invalidate();
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.gutter.reserveRoom(this, null);
    for (const l of this.layers) this.closeLayer(l);
    this.plot?.destroy();
  }
}
