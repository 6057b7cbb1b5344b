// A timeline panel with a value axis: several streams over one another, each drawn by its visualizer in the draw hook of
// uPlot, which keeps scales, axes and grid.

import uPlot from "uplot";
import { GUTTER, FONT, theme, seriesColor, keyIndex } from "../page/theme.js";
import { duration, ticks } from "../time/text.js";
import { axisNumber, valueTicks, paddedRange } from "../page/number_text.js";
import { brackets } from "../visualizers/paint.js";
import { visualizers } from "../visualizers/index.js";

// Room above the signals for their names and values.
const LEGEND = 22;
// A second click within so many ms is a double click.
const DOUBLE = 220;

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
    this.legend.addEventListener("click", (e) => this.clicked(e));
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
      const key = JSON.stringify([vis.viz, vis.stream, vis.path, vis.channel]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.app.client.close(l.channel);
    this.named = null;
    this.buildLegend();
    this.app.schedule(this);
  }

  openLayer(key, vis) {
    const px = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const channel = this.app.client.open(
      { stream: vis.stream, viz: vis.viz, path: vis.path, channel: vis.channel },
      () => this.app.schedule(this),
      { px },
    );
    return { key, channel, vis, drawer: visualizers.get(vis.draw) ?? visualizers.get("line") };
  }

  // What is drawn: one entry for each layer, or for each key of a stream of maps.
  lines() {
    return this.layers.flatMap((l) => l.drawer.entries(l));
  }

  // The legend has an entry for each, and for a stream of which nothing came.
  buildLegend() {
    const entries = this.lines();
    for (const layer of this.layers) {
      if (!entries.some((e) => e.layer === layer)) entries.push({ layer, name: "", series: null });
    }
    const named = JSON.stringify(entries.map((e) => [e.layer.vis.name, e.name, this.color(e, 0), e.layer.vis.props?.visible]));
    const same = named === this.named;
    this.named = named;
    const rows = this.entries;
    this.entries = entries.map((e, i) => ({ ...e, value: same ? rows[i].value : null, text: same ? rows[i].text : null }));
    if (same) return;
    this.legend.textContent = "";
    let nth = 0, before = null;
    for (const e of this.entries) {
      const row = this.legend.appendChild(document.createElement("button"));
      row.className = "legend-item";
      row.dataset.stream = e.layer.vis.stream;
      row.dataset.key = e.name;
      const swatch = row.appendChild(document.createElement("i"));
      swatch.style.background = this.color(e, nth++);
      // of neighbours in one group the first is named in full
      const { name, short } = e.layer.vis;
      const stream = before && group(before.vis.name) === group(name) ? short ?? name : name;
      const full = e.name === "" ? e.layer.vis.name : `${e.layer.vis.name}  ${e.name}`;
      row.title = `${full}\nClick: hide or show. Double click: only this one.`;
      row.type = "button";
      row.classList.toggle("hidden", e.layer.vis.props?.visible === false);
      row.setAttribute("aria-pressed", String(e.layer.vis.props?.visible !== false));
      // a stream is named once, then its keys
      row.appendChild(document.createElement("span")).textContent =
        e.name === "" ? stream : before === e.layer ? e.name : `${stream} ${e.name}`;
      before = e.layer;
      e.value = row.appendChild(document.createElement("b"));
    }
    this.more();
  }

  // A name is a switch: a click hides or shows, a double click leaves it alone.
  clicked(e) {
    const stream = e.target.closest(".legend-item")?.dataset.stream;
    const index = this.config.vis.findIndex((v) => v.stream === stream);
    const panel = this.el.closest("[data-panel]")?.dataset.panel;
    if (index < 0 || !panel) return;
    clearTimeout(this.clickTimer);
    const push = (more) => this.app.options.push?.("show_vis", { panel, index, ...more });
    if (e.detail > 1) push({ only: "true" });
    else this.clickTimer = setTimeout(push, DOUBLE, {});
  }

  // Entries for which there is no room are counted.
  more() {
    const rows = [...this.legend.children];
    const hidden = rows.filter((r) => r.offsetTop > rows[0].offsetTop + 4);
    this.rest.textContent = hidden.length ? `+${hidden.length}` : "";
    this.rest.title = hidden.map((r) => r.title).join("\n");
  }

  color({ layer, name }, nth) {
    const own = layer.vis.color ?? layer.index;
    return seriesColor(layer.vis.props?.color, name === "" ? own : keyIndex(name, own + nth));
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
          size: () => GUTTER.left, gap: 6, font: FONT, stroke: () => theme().axis, ticks: { show: false }, grid: grid(),
          splits: (u, _i, lo, hi) => valueTicks(lo, hi, Math.max(2, Math.floor((u.height - LEGEND) / 24))),
          values: (_u, at) => this.labels(at),
        },
      ],
      hooks: { draw: [(u) => this.draw(u)] },
    };
    this.plot = new uPlot(options, [[0, 1], [null, null]], this.body);
  }

  range(view) {
    const axis = this.config.axis ?? {};
    if (axis.mode === "fixed" && axis.max > axis.min) return [axis.min, axis.max];
    const [lo, hi] = paddedRange(this.lines().map((e) => e.layer.drawer.extent(e, view)));
    if (!this.layers.length || !this.layers.every((l) => l.drawer.symmetric)) return [lo, hi];
    const m = Math.max(Math.abs(lo), Math.abs(hi), 1e-3);
    return [-m, m];
  }

  // The numbers beside the axis; none before there is anything to measure.
  labels(at) {
    const texts = this.loading ? at.map(() => "") : at.map(axisNumber);
    this.app.gutter.need(this, texts);
    return texts;
  }

  // Called once per picture, at most, when something this panel shows has changed.
  render() {
    if (!this.plot) return;
    this.loading = this.layers.some((l) => !l.channel.held && !l.channel.error) && !this.lines().some((e) => e.series.length);
    this.el.classList.toggle("loading", this.loading);
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
      const { props = {} } = e.layer.vis;
      if (props.visible !== false) e.layer.drawer.draw(ctx, e, { view, x, y, ratio, props, color: this.color(e, i) });
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

  // Values at the cursor, in the legend; one that is older than the stream's pace explains says how old it is.
  values() {
    const cursor = this.app.time.get().cursor;
    for (const e of this.entries) {
      const { channel, drawer } = e.layer;
      const i = e.series ? e.series.at(cursor) : -1;
      let text = channel.error ?? "", old = false;
      if (!channel.error && i >= 0) {
        text = drawer.text(e, i);
        const age = e.series.age(i, cursor);
        old = age > 0 && text !== "";
        if (old) text += `, ${duration(age)} ago`;
        if (e.series.sampled) text += " (a sample)";
      }
      if (e.text !== text) e.value.textContent = e.text = text;
      e.value.classList.toggle("bad", !!channel.error);
      e.value.classList.toggle("old", old);
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
    this.app.gutter.need(this, null);
    for (const l of this.layers) this.app.client.close(l.channel);
    this.plot?.destroy();
  }
}
