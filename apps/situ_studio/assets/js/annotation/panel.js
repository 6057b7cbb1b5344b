// The panel where annotations are made and changed: a row a track, on the time axis of the others.

import { fitted } from "../page/gutter.js";
import { GUTTER, FONT, theme } from "../page/theme.js";
import { tip } from "../page/tip.js";
import { toast } from "../page/toast.js";
import { rulerTicks, shown } from "../time/clock.js";
import { duration } from "../time/text.js";
import { ROW, drawOne } from "./draw.js";
import { annotator } from "./annotator.js";
import { KeyState } from "./keys.js";
import { typed } from "./commands.js";
import { Spatial } from "./spatial.js";
import { Tools } from "./tools.js";

const NEAR = 5;
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
    if (told.recovered && !this.welcomed) toast(`${told.recovered} unsaved edits were restored`);
    this.welcomed = true;
    if (!this.tracks().includes(this.track)) this.track = this.tracks()[0];
    if (this.selected && !this.item()) this.selected = null;
    this.app.gutter.need(this, this.tracks());
    this.tools.update();
    this.grow();
    this.shown();
  }

  // The tools take as many rows as they need; below them is a row a track.
  get head() {
    return this.tools.height;
  }

  grow() {
    const flex = `0 0 ${this.head + this.tracks().length * ROW + 10}px`;
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
    const track = this.tracks()[Math.floor((e.clientY - box.top - this.head) / ROW)] ?? null;
    return { t, px, track };
  }

  // The annotation under the mouse, and its edge where that is near: {item, edge}.
  at(e) {
    const { t, px, track } = this.place(e);
    const own = this.told.items.filter((a) => a.track === track);
    for (const edge of ["to", "from"]) {
      const item = own.find((a) => Math.abs(a[edge] - t) < NEAR * px);
      if (item) return { item, edge };
    }
    return { item: own.find((a) => a.from <= t && t <= a.to) ?? null, edge: null };
  }

  down(e) {
    if (e.button !== 0 || e.target.closest(".annotation-tools")) return;
    this.el.focus({ preventScroll: true });
    const { track } = this.place(e);
    if (track !== null) this.track = track;
    const { item, edge } = this.at(e);
    this.selected = item?.id ?? null;
    this.tools.update();
    this.app.schedule(this);
    if (edge) this.dragEdge(e, item, edge);
  }

  // An edge follows the mouse; what touches it goes along, but with the Alt key. It snaps to changes of the other
  // panels.
  dragEdge(e, item, edge) {
    e.stopImmediatePropagation();
    this.el.setPointerCapture(e.pointerId);
    const move = (m) => {
      const { t, px } = this.place(m);
      this.drag = { id: item.id, edge, t: m.shiftKey ? t : this.snapped(t, px * NEAR, item.id) };
      this.app.schedule(this);
    };
    const up = (m) => {
      this.el.removeEventListener("pointermove", move);
      const { drag } = this;
      this.drag = null;
      if (drag) this.moveEdge(item, edge, drag.t, m.altKey);
    };
    this.el.addEventListener("pointermove", move);
    this.el.addEventListener("pointerup", up, { once: true });
  }

  snapped(t, near, id) {
    let best = t,
      least = near;
    const own = this.told.items.filter((a) => a.id !== id).flatMap((a) => [a.from, a.to]);
    const others = [...this.app.views].filter((v) => v !== this).flatMap((v) => v.changes?.() ?? []);
    for (const c of [...own, ...others]) if (Math.abs(c - t) < least) [best, least] = [c, Math.abs(c - t)];
    return best;
  }

  hover(e) {
    if (e.buttons) return tip(this, []);
    const { item, edge } = this.at(e);
    this.el.style.cursor = edge ? "ew-resize" : "";
    tip(this, item ? this.words(item) : [], e.clientX, e.clientY);
  }

  words(a) {
    const show = (t) => shown(t, this.app.client.origin);
    const values = Object.entries(a.values).map(([name, v]) => `${name}: ${v}`);
    const about = [
      a.proposed ? "proposed" : "",
      a.by ? `by ${a.by}` : "",
      a.confidence != null ? `confidence ${a.confidence}` : "",
    ];
    const when =
      a.to === a.from ? `at ${show(a.from)}` : `${show(a.from)} to ${show(a.to)}, ${duration(a.to - a.from)}`;
    return [`${a.track}   ${when}`, ...values, about.filter(Boolean).join(", "), a.note ?? ""].filter(Boolean);
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
    this.tracks().forEach((track, i) => this.name(ctx, track, head + i * ROW));
    ctx.save();
    ctx.beginPath();
    ctx.rect(GUTTER.left, head - 2, inner, h);
    ctx.clip();
    ctx.fillStyle = c.grid;
    for (const t of rulerTicks(view, inner, this.app.client.origin).at) ctx.fillRect(Math.round(x(t)), head, 1, h);
    this.tracks().forEach((track, i) => {
      for (const a of this.told.items) if (a.track === track) drawOne(ctx, this.dragged(a), x, head + i * ROW, this);
      if (track !== this.track) return;
      for (const p of this.keys.pending(cursor))
        drawOne(ctx, { ...p, track, pending: true }, x, head + i * ROW, this);
    });
    ctx.restore();
    this.drawn = (this.drawn ?? 0) + 1;
  }

  name(ctx, track, y) {
    const c = theme();
    if (track === this.track) {
      ctx.fillStyle = c.accent;
      ctx.fillRect(0, y + 3, 3, ROW - 6);
    }
    ctx.textAlign = "right";
    ctx.fillStyle = track === this.track ? c.text : c.axis;
    ctx.fillText(fitted(ctx, track, GUTTER.left - 14), GUTTER.left - 6, y + ROW / 2);
    ctx.textAlign = "left";
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
