// A timeline panel of rows, each drawn by the visualizer of its stream.

import { GUTTER, FONT, themeColors, seriesColor, keyIndex } from "../page/theme.js";
import { rulerTicks, formatClock } from "../time/clock.js";
import { compareNames } from "../data/series.js";
import { paintBrackets } from "../visualizers/paint.js";
import { segmentAt } from "../data/lanes.js";
import { getVisualizer } from "../visualizers/index.js";
import { showTip } from "../page/tip.js";

const ROW = 26,
  HIGH = 34;
const EDGE = 4;
const ROOM = 11;
const MOST_LANES = 32;
// How far from a mark or a narrow segment the mouse may be, in pixels.
const NEAR = 4;

export class LanesPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("lanes");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.names = el.appendChild(document.createElement("div"));
    this.names.className = "lane-names";
    this.layers = [];
    /** @type {{l: any, lane: string, index: number}[] | null} */
    this.rows = null;
    this.row = ROW;
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    el.addEventListener("pointermove", (e) =>
      showTip(this, e.buttons ? [] : this.describeUnder(e), e.clientX, e.clientY),
    );
    el.addEventListener("dblclick", (e) => {
      const found = this.segmentUnder(e);
      if (!found) return;
      this.app.time.dispatch({ type: "select", from: found[0], to: found[1] });
      this.app.time.dispatch({ type: "zoomSel" });
    });
    el.addEventListener("pointerleave", () => showTip(this, []));
    this.resize();
  }

  // Returns the row and the time under the mouse, and the number of ns per pixel.
  locatePointer(e) {
    const box = this.el.getBoundingClientRect();
    const row = this.rows?.[Math.floor((e.clientY - box.top - EDGE) / this.row)];
    const view = this.app.time.get().view;
    const px = (view[1] - view[0]) / (box.width - GUTTER.left - GUTTER.right);
    const t = view[0] + (e.clientX - box.left - GUTTER.left) * px;
    return !row || t < view[0] || t > view[1] ? null : { row, t, px };
  }

  // Describes the item under the mouse, since labels are shortened if they do not fit.
  describeUnder(e) {
    const at = this.locatePointer(e);
    if (!at) return [];
    const { row, t, px } = at;
    const formatTime = (time) => formatClock(time, this.app.client.origin, Math.max(px, 1) > 1e5 ? 1e6 : 1e3);
    return row.l.drawer.describeAt({ channel: row.l.channel, name: row.lane }, t, NEAR * px, formatTime);
  }

  // Returns the times at which segments begin or end.
  changeTimes() {
    return this.layers
      .flatMap((l) => [...(l.channel.segments?.values() ?? [])])
      .flatMap((rows) => rows.flatMap(([a, b]) => (Number.isFinite(b) ? [a, b] : [a])));
  }

  // Returns the times at which segments of a stream begin. A snapped cursor cannot stay at their ends.
  startTimes(stream) {
    return this.layers
      .filter((l) => l.vis.stream === stream)
      .flatMap((l) => [...(l.channel.segments?.values() ?? [])])
      .flatMap((rows) => rows.map(([a]) => a));
  }

  // Returns the segment under the mouse as a time interval, or null.
  segmentUnder(e) {
    const at = this.locatePointer(e);
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
      const layer = old.get(key) ?? { key, channel: this.openChannel(vis) };
      old.delete(key);
      const drawer = getVisualizer(vis.draw, "messages");
      return Object.assign(layer, { vis, index, drawer });
    });
    for (const l of old.values()) this.app.client.closeChannel(l.channel);
    this.rows = null;
    this.app.scheduleDraw(this);
  }

  // Lays out one row for each stream, or for each key of a stream of maps.
  layOut() {
    const rows = this.layers.flatMap((l) => knownLanes(l).map((lane, i) => ({ l, lane, index: keyIndex(lane, i) })));
    const named = JSON.stringify(rows.map((r) => [r.l.index, r.lane]));
    if (this.rows && named === this.named) return;
    this.rows = rows;
    this.named = named;
    this.names.textContent = "";
    for (const { l, lane } of rows) {
      const name = this.names.appendChild(document.createElement("div"));
      name.className = "lane-name";
      name.title = lane === "" ? l.vis.name : `${l.vis.name}  ${lane}`;
      // too long names are cut at the beginning, since the end distinguishes lanes
      const short = l.vis.short ?? l.vis.name;
      name.appendChild(document.createElement("bdi")).textContent = laneName(short, lane);
    }
    this.fitRows();
    this.app.gutter.reserveRoom(
      this,
      rows.map(({ l, lane }) => laneName(l.vis.short ?? l.vis.name, lane)),
    );
    for (const l of this.layers) {
      const count = rows.filter((r) => r.l === l).length;
      if (count > (l.laneCount ?? 1))
        this.app.pushLaneCount(l.vis.stream + (l.vis.path ?? ""), (l.laneCount = count));
    }
  }

  // Divides the available height among the rows.
  fitRows() {
    const room = (this.el.clientHeight - 2 * EDGE + 1) / Math.max(this.rows?.length ?? 1, 1);
    this.row = Math.max(Math.min(HIGH, room), 3);
    const style = this.names.style;
    style.setProperty("--row", `${this.row}px`);
    style.setProperty("--font", `${Math.min(11, this.row)}px`);
    style.paddingTop = `${EDGE - 4 * Math.min(1, this.row / ROW)}px`;
  }

  openChannel(vis) {
    const widthInPixels = () => Math.max(this.el.clientWidth - GUTTER.left - GUTTER.right, 0);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path };
    return this.app.client.openChannel(spec, () => this.app.scheduleDraw(this), { px: widthInPixels });
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.fitRows();
    this.app.client.pump();
    this.app.scheduleDraw(this);
  }

  // Draws on the screen, or on another context such as `page/svg_context.js`.
  render(ctx = this.canvas.getContext("2d")) {
    this.layOut();
    this.el.classList.toggle(
      "loading",
      this.layers.some((l) => !l.channel.held && !l.channel.error),
    );
    const t = themeColors();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    const { view, data } = this.app.time.get();
    const inner = w - GUTTER.left - GUTTER.right;
    const k = inner / (view[1] - view[0]);
    const timeToX = (time) => GUTTER.left + (time - view[0]) * k;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.strokeStyle = t.grid;
    ctx.lineWidth = 1;
    ctx.beginPath();
    for (const at of rulerTicks(view, inner, this.app.client.origin).at) {
      const px = Math.round(timeToX(at)) + 0.5;
      ctx.moveTo(px, 0);
      ctx.lineTo(px, h);
    }
    ctx.stroke();
    ctx.save();
    ctx.beginPath();
    ctx.rect(GUTTER.left, 0, inner, h);
    ctx.clip();
    this.rows?.forEach(({ l, lane, index }, i) => {
      const at = { y: EDGE + i * this.row, h: Math.max(this.row - Math.min(8, this.row * 0.3), 2), x: timeToX };
      if (l.channel.error) return this.drawNote(ctx, l.channel.error, at);
      const color = seriesColor(l.vis.props?.color, l.vis.color ?? l.index);
      l.drawer.draw(ctx, { channel: l.channel, name: lane, index }, { view, color, end: data[1], ...at });
      const ends = this.app.client.relativeEnds(l.vis.ends);
      if (ends) this.drawEnds(ctx, ends, at);
    });
    ctx.restore();
    this.drawn = (this.drawn ?? 0) + 1;
  }

  // Draws the ends of a stream. The last state is extended beyond the end in a paler color, since no message
  // confirms it.
  drawEnds(ctx, ends, { x, y, h }) {
    const t = themeColors();
    if (ends.last != null) {
      ctx.globalAlpha = 0.6;
      ctx.fillStyle = t.panel;
      ctx.fillRect(x(ends.last) + 1, y, x(this.app.time.get().data[1]) - x(ends.last), h);
      ctx.globalAlpha = 1;
    }
    paintBrackets(ctx, ends, x, y - 1, y + h + 1, { color: t.axis });
  }

  drawNote(ctx, text, { y }) {
    ctx.font = FONT;
    ctx.fillStyle = themeColors().warn;
    ctx.fillText(text, GUTTER.left + 6, y + 13);
  }

  cursorMoved() {}

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.app.gutter.reserveRoom(this, null);
    showTip(this, []);
    for (const l of this.layers) this.app.client.closeChannel(l.channel);
  }
}

// Returns the lanes of a layer. Known lanes are kept even if the window has none of their data, so that rows do not
// jump.
function knownLanes(l) {
  const named = l.drawer.laneNames(l.channel).filter((n) => n !== "");
  if (named.length) l.known = [...new Set([...(l.known ?? []), ...named])].sort(compareNames).slice(0, MOST_LANES);
  return l.known ?? [""];
}

// Returns a lane's name. If there is no room for both, a key that is not a number replaces the stream's name.
const laneName = (short, lane) =>
  lane === "" ? short : isNaN(lane) && short.length + lane.length > ROOM ? lane : `${short} ${lane}`;
