// A timeline panel with a value axis: lines, waveforms and latency of several streams over one another.
// uPlot keeps scales, axes and grid; the signals are painted in its draw hook.

import uPlot from "uplot";
import { GUTTER, FONT, theme, seriesColor, keyIndex } from "./theme.js";
import { ticks } from "./time_text.js";
import { number, valueTicks, paddedRange } from "./number_text.js";
import { byName } from "./series.js";
import * as paint from "./paint.js";

// Room above the signals for their names and values.
const LEGEND = 22;

const group = (name) => name.slice(0, name.lastIndexOf(".") + 1);

export class PlotPanel {
  // app: {time, client, schedule}; config: {vis: [{id, draw, stream, name, props}], axis: {mode, min, max}}
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("plot");
    this.body = el.appendChild(document.createElement("div"));
    this.body.className = "plot-body";
    this.legend = el.appendChild(document.createElement("div"));
    this.legend.className = "legend";
    this.rest = el.appendChild(document.createElement("div"));
    this.rest.className = "legend-more";
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
      const key = JSON.stringify([vis.draw, vis.stream, vis.path, vis.channel]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      layer.vis = vis;
      layer.index = index;
      return layer;
    });
    for (const l of old.values()) this.app.client.close(l.channel);
    this.named = null;
    this.buildLegend();
    this.app.schedule(this);
  }

  openLayer(key, vis) {
    const px = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const channel = this.app.client.open(
      { stream: vis.stream, draw: vis.draw, path: vis.path, channel: vis.channel },
      () => this.app.schedule(this),
      { px },
    );
    return { key, channel, vis };
  }

  // What is drawn: a line for each layer, or for each key of a stream of maps.
  lines() {
    return this.layers.flatMap((l) => {
      if (l.vis.draw !== "lines") return [{ l, name: "", series: l.channel.series }];
      return [...l.channel.lines].sort(([a], [b]) => byName(a, b)).map(([name, series]) => ({ l, name, series }));
    });
  }

  // The legend has an entry for each, and for a stream of which nothing came.
  buildLegend() {
    const entries = this.lines();
    for (const l of this.layers) if (!entries.some((e) => e.l === l)) entries.push({ l, name: "", series: null });
    const named = JSON.stringify(entries.map((e) => [e.l.vis.name, e.name, this.color(e, 0)]));
    const same = named === this.named;
    this.named = named;
    const rows = this.entries;
    this.entries = entries.map((e, i) => ({ ...e, value: same ? rows[i].value : null, text: same ? rows[i].text : null }));
    if (same) return;
    this.legend.textContent = "";
    let nth = 0, before = null;
    for (const e of this.entries) {
      const row = this.legend.appendChild(document.createElement("span"));
      row.className = "legend-item";
      row.dataset.stream = e.l.vis.stream;
      row.dataset.key = e.name;
      const swatch = row.appendChild(document.createElement("i"));
      swatch.style.background = this.color(e, nth++);
      // of neighbours in one group the first is named in full
      const { name, short } = e.l.vis;
      const stream = before && group(before.vis.name) === group(name) ? short ?? name : name;
      row.title = e.name === "" ? e.l.vis.name : `${e.l.vis.name}  ${e.name}`;
      // a stream is named once, then its keys
      row.appendChild(document.createElement("span")).textContent =
        e.name === "" ? stream : before === e.l ? e.name : `${stream} ${e.name}`;
      before = e.l;
      e.value = row.appendChild(document.createElement("b"));
    }
    this.more();
  }

  // Entries for which there is no room are counted.
  more() {
    const rows = [...this.legend.children];
    const hidden = rows.filter((r) => r.offsetTop > rows[0].offsetTop + 4);
    this.rest.textContent = hidden.length ? `+${hidden.length}` : "";
    this.rest.title = hidden.map((r) => r.title).join("\n");
  }

  color({ l, name }, nth) {
    const own = l.vis.color ?? l.index;
    return seriesColor(l.vis.props?.color, name === "" ? own : keyIndex(name, own + nth));
  }

  resize() {
    const w = this.el.clientWidth, h = this.el.clientHeight;
    if (!w || !h || (w === this.size[0] && h === this.size[1])) return;
    this.size = [w, h];
    if (!this.plot) this.build(w, h);
    else this.plot.setSize({ width: w, height: h });
    this.more();
    this.app.client.pump();
    this.app.schedule(this);
  }

  build(width, height) {
    const grid = () => ({ stroke: () => theme().grid, width: 1 });
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
        y: { auto: false, range: () => this.y },
      },
      series: [{}, { paths: () => null, points: { show: false } }],
      axes: [
        {
          size: 0, ticks: { show: false }, grid: grid(), values: () => [],
          splits: (u, _i, lo, hi) => ticks([lo, hi], u.width - GUTTER.left - GUTTER.right).at,
        },
        {
          size: GUTTER.left, gap: 6, font: FONT, stroke: () => theme().axis, ticks: { show: false }, grid: grid(),
          splits: (u, _i, lo, hi) => valueTicks(lo, hi, Math.max(2, Math.floor((u.height - LEGEND) / 24))),
          values: (_u, at) => at.map((v) => number(v)),
        },
      ],
      hooks: { draw: [(u) => this.draw(u)] },
    };
    this.plot = new uPlot(options, [[0, 1], [null, null]], this.body);
  }

  range(view) {
    const axis = this.config.axis ?? {};
    if (axis.mode === "fixed" && axis.max > axis.min) return [axis.min, axis.max];
    const only = this.layers.length > 0 && this.layers.every((l) => l.vis.draw === "waveform");
    const extents = this.lines().map((e) => e.series.extent(view[0], view[1]));
    if (this.layers.some((l) => l.vis.draw === "latency")) extents.push([0, 0]);
    const [lo, hi] = paddedRange(extents);
    if (!only) return [lo, hi];
    const m = Math.max(Math.abs(lo), Math.abs(hi), 1e-3);
    return [-m, m];
  }

  // Called once per picture, at most, when something this panel shows has changed.
  render() {
    if (!this.plot) return;
    const view = this.app.time.get().view;
    this.buildLegend();
    this.y = this.range(view);
    this.plot.batch(() => {
      this.plot.setScale("x", { min: view[0], max: view[1] });
      this.plot.setScale("y", { min: this.y[0], max: this.y[1] });
    });
    this.plot.redraw(false, true);
    this.values();
  }

  draw(u) {
    const { ctx, bbox } = u;
    const view = this.app.time.get().view;
    const ratio = devicePixelRatio;
    const kx = bbox.width / (view[1] - view[0]);
    const ky = bbox.height / (this.y[1] - this.y[0]);
    const x = (t) => bbox.left + (t - view[0]) * kx;
    const y = (v) => bbox.top + bbox.height - (v - this.y[0]) * ky;
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    this.lines().forEach((e, i) => {
      const { props = {}, draw } = e.l.vis;
      if (props.visible === false) return;
      const color = this.color(e, i);
      if (draw === "waveform") paint.wave(ctx, e.series, view, x, y, { color, ratio });
      else if (draw === "latency") {
        paint.stems(ctx, e.series, view, x, y, { color, warn: theme().warn, threshold: props.threshold_ms ?? 50, ratio });
      } else {
        const { interpolation, width, markers } = props;
        paint.line(ctx, e.series, view, x, y, {
          color, ratio, width, step: interpolation === "step", joined: interpolation !== "none",
          points: markers === true || interpolation === "none",
        });
      }
    });
    for (const l of this.layers) {
      const ends = l.vis.props?.visible !== false && this.app.client.ends(l.vis.ends);
      if (ends) paint.brackets(ctx, ends, x, bbox.top, bbox.top + bbox.height, { color: this.color({ l, name: "" }, 0), ratio });
    }
    this.cover(ctx, bbox, y);
    ctx.restore();
    this.drawn = (this.drawn ?? 0) + 1;
  }

  // What lies beyond the threshold is covered, so that the rest stands out.
  cover(ctx, bbox, y) {
    const { side, value } = this.config.threshold ?? {};
    if (!side) return;
    const at = Math.min(Math.max(y(value), bbox.top), bbox.top + bbox.height);
    ctx.fillStyle = theme().panel;
    ctx.globalAlpha = 0.75;
    if (side === "below") ctx.fillRect(bbox.left, at, bbox.width, bbox.top + bbox.height - at);
    else ctx.fillRect(bbox.left, bbox.top, bbox.width, at - bbox.top);
    ctx.globalAlpha = 1;
    ctx.fillStyle = theme().warn;
    ctx.fillRect(bbox.left, at, bbox.width, devicePixelRatio);
  }

  // Values at the cursor, in the legend.
  values() {
    const cursor = this.app.time.get().cursor;
    for (const e of this.entries) {
      const { l, series: s } = e;
      const i = s ? s.at(cursor) : -1;
      let text = "";
      if (l.channel.error) text = l.channel.error;
      else if (i >= 0 && Number.isFinite(s.last[i])) {
        text = number(s.last[i], 5);
        if (l.vis.draw === "latency") text += " ms";
        else if (l.vis.props?.unit) text += " " + l.vis.props.unit;
      }
      if (e.text !== text) e.value.textContent = e.text = text;
      e.value.classList.toggle("bad", !!l.channel.error);
    }
  }

  cursorMoved() {
    this.values();
  }

  themeChanged() {
    this.named = null;
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    for (const l of this.layers) this.app.client.close(l.channel);
    this.plot?.destroy();
  }
}
