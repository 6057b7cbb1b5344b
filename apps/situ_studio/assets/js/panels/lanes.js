// A timeline panel of rows, each drawn by its stream's visualizer.

import { GUTTER, FONT, theme, seriesColor, keyIndex } from "../page/theme.js";
import { rulerTicks, shown } from "../time/clock.js";
import { byName } from "../data/series.js";
import { brackets } from "../visualizers/paint.js";
import { segmentAt } from "../data/lanes.js";
import { visualizers } from "../visualizers/index.js";
import { tip } from "../page/tip.js";

const ROW = 26,
  HIGH = 34;
const EDGE = 4;
const ROOM = 11;
const MOST_LANES = 32;
// How far beside a mark or a narrow segment the mouse may be, in pixels.
const NEAR = 4;

export class LanesPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("lanes");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.names = el.appendChild(document.createElement("div"));
    this.names.className = "lane-names";
    this.layers = [];
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    el.addEventListener("pointermove", (e) => tip(this, e.buttons ? [] : this.under(e), e.clientX, e.clientY));
    el.addEventListener("dblclick", (e) => {
      const found = this.segment(e);
      if (!found) return;
      this.app.time.dispatch({ type: "select", from: found[0], to: found[1] });
      this.app.time.dispatch({ type: "zoomSel" });
    });
    el.addEventListener("pointerleave", () => tip(this, []));
    this.resize();
  }

  // The row and the time under the mouse, and how many ns a pixel is.
  place(e) {
    const box = this.el.getBoundingClientRect();
    const row = this.rows?.[Math.floor((e.clientY - box.top - EDGE) / this.row)];
    const view = this.app.time.get().view;
    const px = (view[1] - view[0]) / (box.width - GUTTER.left - GUTTER.right);
    const t = view[0] + (e.clientX - box.left - GUTTER.left) * px;
    return !row || t < view[0] || t > view[1] ? null : { row, t, px };
  }

  // The things under the mouse, in words: labels are cut where there is no room for them.
  under(e) {
    const at = this.place(e);
    if (!at) return [];
    const { row, t, px } = at;
    const show = (time) => shown(time, this.app.client.origin, Math.max(px, 1) > 1e5 ? 1e6 : 1e3);
    return row.l.drawer.under({ channel: row.l.channel, name: row.lane }, t, NEAR * px, show);
  }

  // The times at which something begins or ends.
  changes() {
    return this.layers
      .flatMap((l) => [...(l.channel.segments?.values() ?? [])])
      .flatMap((rows) => rows.flatMap(([a, b]) => (Number.isFinite(b) ? [a, b] : [a])));
  }

  // The segment under the mouse as an interval of time, or null.
  segment(e) {
    const at = this.place(e);
    if (!at?.row) return null;
    const segments = at.row.l.channel.segments?.get(at.row.lane) ?? [];
    const found = segmentAt(segments, at.t, NEAR * at.px);
    return found && [found[0], Number.isFinite(found[1]) ? found[1] : this.app.time.get().data[1]];
  }

  configure(config) {
    this.config = config;
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.viz, vis.stream, vis.path]);
      const layer = old.get(key) ?? { key, channel: this.open(vis) };
      old.delete(key);
      const drawer = visualizers.get(vis.draw) ?? visualizers.get("messages");
      return Object.assign(layer, { vis, index, drawer });
    });
    for (const l of old.values()) this.app.client.close(l.channel);
    this.rows = null;
    this.app.schedule(this);
  }

  // One row a stream, or one for each key of a stream of maps.
  layOut() {
    const rows = this.layers.flatMap((l) => known(l).map((lane, i) => ({ l, lane, index: keyIndex(lane, i) })));
    const named = JSON.stringify(rows.map((r) => [r.l.index, r.lane]));
    if (this.rows && named === this.named) return;
    this.rows = rows;
    this.named = named;
    this.names.textContent = "";
    for (const { l, lane } of rows) {
      const name = this.names.appendChild(document.createElement("div"));
      name.className = "lane-name";
      name.title = lane === "" ? l.vis.name : `${l.vis.name}  ${lane}`;
      // cut at the beginning when too long: the end tells lanes apart
      const short = l.vis.short ?? l.vis.name;
      name.appendChild(document.createElement("bdi")).textContent = laneName(short, lane);
    }
    this.fit();
    this.app.gutter.need(
      this,
      rows.map(({ l, lane }) => laneName(l.vis.short ?? l.vis.name, lane)),
    );
    for (const l of this.layers) {
      const count = rows.filter((r) => r.l === l).length;
      if (count > (l.told ?? 1)) this.app.tellLanes(l.vis.stream + (l.vis.path ?? ""), (l.told = count));
    }
  }

  // Rows share the height there is.
  fit() {
    const room = (this.el.clientHeight - 2 * EDGE + 1) / Math.max(this.rows?.length ?? 1, 1);
    this.row = Math.max(Math.min(HIGH, room), 3);
    const style = this.names.style;
    style.setProperty("--row", `${this.row}px`);
    style.setProperty("--font", `${Math.min(11, this.row)}px`);
    style.paddingTop = `${EDGE - 4 * Math.min(1, this.row / ROW)}px`;
  }

  open(vis) {
    const px = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path };
    return this.app.client.open(spec, () => this.app.schedule(this), { px });
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.fit();
    this.app.client.pump();
    this.app.schedule(this);
  }

  // On the screen, or on what takes the same drawing (`page/vector.js`).
  render(ctx = this.canvas.getContext("2d")) {
    this.layOut();
    this.el.classList.toggle(
      "loading",
      this.layers.some((l) => !l.channel.held && !l.channel.error),
    );
    const t = theme();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    const { view, data } = this.app.time.get();
    const inner = w - GUTTER.left - GUTTER.right;
    const k = inner / (view[1] - view[0]);
    const x = (time) => GUTTER.left + (time - view[0]) * k;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.strokeStyle = t.grid;
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (const at of rulerTicks(view, inner, this.app.client.origin).at) {
      const px = Math.round(x(at)) + 0.5;
      ctx.moveTo(px, 0);
      ctx.lineTo(px, h);
    }
    ctx.stroke();
    ctx.save();
    ctx.beginPath();
    ctx.rect(GUTTER.left, 0, inner, h);
    ctx.clip();
    this.rows.forEach(({ l, lane, index }, i) => {
      const at = { y: EDGE + i * this.row, h: Math.max(this.row - Math.min(8, this.row * 0.3), 2), x };
      if (l.channel.error) return this.note(ctx, l.channel.error, at);
      const color = seriesColor(l.vis.props?.color, l.vis.color ?? l.index);
      l.drawer.draw(ctx, { channel: l.channel, name: lane, index }, { view, color, end: data[1], ...at });
      const ends = this.app.client.ends(l.vis.ends);
      if (ends) this.ends(ctx, ends, at);
    });
    ctx.restore();
    this.drawn = (this.drawn ?? 0) + 1;
  }

  // A state that is in force at a stream's end holds on, but nobody said so any more: it is paler there.
  ends(ctx, ends, { x, y, h }) {
    const t = theme();
    if (ends.last != null) {
      ctx.globalAlpha = 0.6;
      ctx.fillStyle = t.panel;
      ctx.fillRect(x(ends.last) + 1, y, x(this.app.time.get().data[1]) - x(ends.last), h);
      ctx.globalAlpha = 1;
    }
    brackets(ctx, ends, x, y - 1, y + h + 1, { color: t.axis });
  }

  note(ctx, text, { y }) {
    ctx.font = FONT;
    ctx.fillStyle = theme().warn;
    ctx.fillText(text, GUTTER.left + 6, y + 13);
  }

  cursorMoved() {}

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.gutter.need(this, null);
    tip(this, []);
    for (const l of this.layers) this.app.client.close(l.channel);
  }
}

// A lane that was there stays, also where the window holds nothing of it: rows must not jump.
function known(l) {
  const named = l.drawer.lanes(l.channel).filter((n) => n !== "");
  if (named.length) l.known = [...new Set([...(l.known ?? []), ...named])].sort(byName).slice(0, MOST_LANES);
  return l.known ?? [""];
}

// A key that says enough stands alone where there is no room for its stream's name too.
const laneName = (short, lane) =>
  lane === "" ? short : isNaN(lane) && short.length + lane.length > ROOM ? lane : `${short} ${lane}`;
