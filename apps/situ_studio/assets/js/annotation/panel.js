// The panel where annotations are made and changed: a row a track, on the time axis of the others.

import { GUTTER, FONT, theme } from "../page/theme.js";
import { tip } from "../page/tip.js";
import { toast } from "../page/toast.js";
import { rulerTicks } from "../time/clock.js";
import { ROW, drawOne } from "./draw.js";
import { annotator } from "./annotator.js";
import { KeyState } from "./keys.js";
import { dragEdge, near, words } from "./mouse.js";
import { drawName, nameOf, rowsOf } from "./rows.js";
import { typed } from "./commands.js";
import { Spatial } from "./spatial.js";
import { Tools } from "./tools.js";

const FIRST = "1";

export class AnnotationPanel {
  constructor(el, app) {
    Object.assign(this, { el, app });
    el.classList.add("annotations");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.told = { attributes: [], tracks: [], items: [], undo: 0, redo: 0 };
    this.keys = new KeyState();
    this.track = FIRST;
    this.attribute = 0;
    this.shownTracks = "all";
    this.spatial = new Spatial(this);
    this.tools = new Tools(el, this);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    el.addEventListener("pointerdown", (e) => this.down(e));
    el.addEventListener("pointermove", (e) => this.hover(e));
    el.addEventListener("pointerleave", () => tip(this, []));
    el.addEventListener("keydown", (e) => typed(this, e));
    this.resize();
  }

  push(what, more = {}) {
    this.app.edited = "annotations";
    this.app.options.push?.("annotation_edit", { do: what, ...more });
  }

  // The server says what there is.
  tell(told) {
    this.raw = told;
    const rel = (ns) => this.app.client.rel(BigInt(ns));
    if (this.app.client.origin === null) return (this.early = told);
    this.told = { ...told, items: told.items.map((a) => ({ ...a, from: rel(a.from), to: rel(a.to) })) };
    this.keys.learn(told.attributes);
    if (told.shadowed && told.shadowed !== this.shadowed)
      toast(`Another program has saved other annotations; they stay in ${told.shadowed}`);
    this.shadowed = told.shadowed;
    if (told.recovered && !this.welcomed) toast(`${told.recovered} unsaved edits were restored`);
    this.welcomed = true;
    if (!this.tracks().includes(this.track)) this.track = this.tracks()[0];
    if (this.selected && !this.item()) this.selected = null;
    if (this.attribute >= told.attributes.length) this.attribute = 0;
    this.app.gutter.need(
      this,
      this.rows().map((r) => this.rowName(r)),
    );
    this.tools.update();
    this.grow();
    this.shown();
  }

  // The tools take as many lines as they need; below them are the rows.
  get head() {
    return this.tools.height;
  }

  grow() {
    const flex = `0 0 ${this.head + this.rows().length * ROW + 10}px`;
    const { parentElement: box } = this.el;
    if (box.style.flex === flex) return;
    box.style.flex = flex;
    // a row more shall be seen
    if (this.welcomed) box.scrollIntoView({ block: "nearest" });
  }

  // Pictures show boxes and points, too.
  shown() {
    this.app.schedule(this);
    for (const v of this.app.views) if (v.base) this.app.schedule(v);
  }

  get annotator() {
    return annotator();
  }

  tracks() {
    const names = new Set(this.told.tracks);
    names.add(this.track);
    return [...names].sort();
  }

  rows() {
    const { told, track, attribute, shownTracks: shown } = this;
    const spatial = this.spatial.kind != null;
    return rowsOf({ told, track, attribute, shown, spatial, tracks: this.tracks() }, this.app.time.get().view);
  }

  rowName(row) {
    const several = this.spatial.kind == null && this.told.attributes.length > 1;
    return nameOf(row, this.told.attributes, several);
  }

  showTracks(shown) {
    this.shownTracks = shown;
    this.grow();
    this.app.schedule(this);
  }

  // The next number that no track has.
  freeTrack() {
    const taken = new Set(this.tracks());
    let n = 1;
    while (taken.has(String(n))) n++;
    return String(n);
  }

  item(id = this.selected) {
    return this.told.items.find((a) => a.id === id) ?? null;
  }

  // --- keys: called for every key of the page while annotating; true when it was ours

  press(e) {
    if (e.ctrlKey || e.metaKey || e.altKey) return false;
    if (this.keys.has(e.key)) {
      if (!e.repeat) this.made(this.keys.down(e.key, this.app.time.get().cursor, performance.now()));
      this.app.schedule(this);
      return true;
    }
    if (e.key === "Escape" && this.keys.cancel()) return (this.app.schedule(this), true);
    return false;
  }

  release(e) {
    if (this.keys.has(e.key)) this.made(this.keys.up(e.key, this.app.time.get().cursor, performance.now()));
  }

  made(annotation) {
    if (annotation) this.add(annotation.from, annotation.to, annotation.values);
  }

  add(from, to, values = {}) {
    const { abs } = this.app.client;
    const at = (t) => abs.call(this.app.client, t);
    this.push("add", { from: at(from), to: at(to), track: this.track, values, by: this.annotator });
  }

  moveEdge({ id }, edge, t, alone = false) {
    this.push("edge", { id, edge, to: this.app.client.abs(t), alone });
  }

  // --- the mouse

  place(e) {
    const box = this.el.getBoundingClientRect();
    const { view } = this.app.time.get();
    const px = (view[1] - view[0]) / (box.width - GUTTER.left - GUTTER.right);
    const t = view[0] + (e.clientX - box.left - GUTTER.left) * px;
    const row = this.rows()[Math.floor((e.clientY - box.top - this.head) / ROW)];
    return { t, px, track: row?.track ?? null, attribute: row?.attribute ?? null };
  }

  // The annotation under the mouse, and its edge where that is near: {item, edge}.
  at(e) {
    const { t, px, track } = this.place(e);
    const own = this.told.items.filter((a) => a.track === track);
    for (const edge of ["to", "from"]) {
      const item = own.find((a) => Math.abs(a[edge] - t) < near(e) * px);
      if (item) return { item, edge };
    }
    return { item: own.find((a) => a.from <= t && t <= a.to) ?? null, edge: null };
  }

  down(e) {
    if (e.button !== 0 || e.target.closest(".annotation-tools")) return;
    this.el.focus({ preventScroll: true });
    const { item, edge } = this.choose(e);
    if (edge) dragEdge(this, e, item, edge);
  }

  // The track, attribute and annotation under the mouse.
  choose(e) {
    const { track, attribute } = this.place(e);
    const found = this.at(e);
    if (track !== null) this.track = track;
    if (attribute !== null) this.attribute = attribute;
    this.selected = found.item?.id ?? null;
    this.tools.update();
    this.app.schedule(this);
    return found;
  }

  hover(e) {
    if (e.buttons) return tip(this, []);
    const { item, edge } = this.at(e);
    this.el.style.cursor = edge ? "ew-resize" : "";
    tip(this, item ? words(item, this.app.client.origin) : [], e.clientX, e.clientY);
  }

  segment(e) {
    const { item, edge } = this.at(e);
    return item && !edge && item.to > item.from ? [item.from, item.to] : null;
  }

  changes() {
    return this.told.items.flatMap((a) => [a.from, a.to]);
  }

  // --- drawing

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.grow();
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.schedule(this);
  }

  render() {
    if (this.early && this.app.client.origin !== null) {
      const { early } = this;
      this.early = null;
      this.tell(early);
    }
    const ctx = this.canvas.getContext("2d"),
      c = theme();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    const { view, cursor } = this.app.time.get();
    const { head } = this;
    const inner = w - GUTTER.left - GUTTER.right;
    const x = (t) => GUTTER.left + ((t - view[0]) * inner) / (view[1] - view[0]);
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.font = FONT;
    ctx.textBaseline = "middle";
    const rows = this.rows();
    if (this.shownTracks === "view") this.grow();
    rows.forEach((r, i) =>
      drawName(ctx, this.rowName(r), head + i * ROW, { chosen: r.track === this.track, first: r.first }),
    );
    ctx.save();
    ctx.beginPath();
    ctx.rect(GUTTER.left, head - 2, inner, h);
    ctx.clip();
    ctx.fillStyle = c.grid;
    for (const t of rulerTicks(view, inner, this.app.client.origin).at) ctx.fillRect(Math.round(x(t)), head, 1, h);
    rows.forEach(({ track, attribute }, i) => {
      const look = { told: this.told, attribute, selected: this.selected, least: this.tools.least };
      for (const a of this.told.items) if (a.track === track) drawOne(ctx, this.dragged(a), x, head + i * ROW, look);
      if (track !== this.track) return;
      for (const p of this.keys.pending(cursor))
        drawOne(ctx, { ...p, track, pending: true }, x, head + i * ROW, look);
    });
    ctx.restore();
    this.drawn = (this.drawn ?? 0) + 1;
  }

  dragged(a) {
    return this.drag?.id === a.id ? { ...a, [this.drag.edge]: this.drag.t } : a;
  }

  cursorMoved() {
    if (this.keys.open.size) this.app.schedule(this);
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    this.told = { ...this.told, attributes: [] };
    this.shown();
    this.app.gutter.need(this, null);
    tip(this, []);
  }
}
