// The time navigator: the whole recording with a thumb for the current view, and a ruler of the view.

import { GUTTER, FONT, readableColor, themeColors } from "../page/theme.js";
import { listBookmarks } from "../page/bookmarks.js";
import { formatDuration } from "./text.js";
import { rulerTicks, formatClock } from "./clock.js";

const BAR = 18;
const GRIP = 6;

export class Navigator {
  constructor(el, app) {
    this.el = el;
    this.app = app;
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    el.addEventListener("pointerdown", (e) => this.handlePointerDown(e));
    el.addEventListener("pointermove", (e) => this.updateCursorStyle(e));
    el.addEventListener("wheel", (e) => this.handleWheel(e), { passive: false });
    el.addEventListener("dblclick", () => this.app.time.dispatch({ type: "zoomAll" }));
    this.resize();
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.scheduleDraw(this);
  }

  // Returns the time range of the bar: the data, and in live mode also the part of the view beyond them.
  shownSpan() {
    const s = this.app.time.get();
    if (s.mode === "live") return [Math.min(s.data[0], s.view[0]), Math.max(s.data[1], s.view[1])];
    return s.data;
  }

  timeScale() {
    const [a, b] = this.shownSpan();
    const inner = this.el.clientWidth - GUTTER.left - GUTTER.right;
    return {
      x: (t) => GUTTER.left + ((t - a) / (b - a)) * inner,
      t: (x) => a + ((x - GUTTER.left) / inner) * (b - a),
      inner,
    };
  }

  handlePointerDown(e) {
    if (e.button !== 0) return;
    const y = e.offsetY;
    if (y > BAR + 6) return; // the ruler belongs to the panels' gestures, see app.js
    const s = this.app.time.get();
    const { x, t } = this.timeScale();
    const left = x(s.view[0]),
      right = x(s.view[1]);
    const at = e.offsetX;
    let part = "body";
    if (Math.abs(at - left) < GRIP) part = "left";
    else if (Math.abs(at - right) < GRIP) part = "right";
    else if (at < left || at > right) {
      const w = s.view[1] - s.view[0];
      const mid = t(at);
      this.app.time.dispatch({ type: "view", from: mid - w / 2, to: mid + w / 2 });
    }
    const start = this.app.time.get().view;
    const t0 = t(at);
    this.el.setPointerCapture(e.pointerId);
    const moveView = (m) => {
      const by = t(m.offsetX) - t0;
      let [from, to] = start;
      if (part !== "right") from += by;
      if (part !== "left") to += by;
      if (from < to) this.app.time.dispatch({ type: "view", from, to });
    };
    const endDrag = () => {
      this.el.removeEventListener("pointermove", moveView);
      this.el.removeEventListener("pointerup", endDrag);
    };
    this.el.addEventListener("pointermove", moveView);
    this.el.addEventListener("pointerup", endDrag);
  }

  updateCursorStyle(e) {
    const s = this.app.time.get();
    const { x } = this.timeScale();
    const isNear = (t) => Math.abs(e.offsetX - x(t)) < GRIP;
    const grip = e.offsetY <= BAR + 6 && (isNear(s.view[0]) || isNear(s.view[1]));
    this.el.style.cursor = grip ? "ew-resize" : e.offsetY <= BAR + 6 ? "grab" : "default";
  }

  handleWheel(e) {
    if (e.offsetY > BAR + 6) return;
    e.preventDefault();
    const { t } = this.timeScale();
    this.app.time.dispatch({ type: "zoomAt", t: t(e.offsetX), factor: e.deltaY > 0 ? 1.2 : 1 / 1.2 });
  }

  render() {
    const ctx = this.canvas.getContext("2d");
    const c = themeColors();
    const s = this.app.time.get();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    const { x, inner } = this.timeScale();
    const top = 5;

    // overview
    ctx.fillStyle = c.grid;
    ctx.fillRect(GUTTER.left, top, inner, BAR);
    if (s.sel[0] != null && s.sel[1] != null) {
      ctx.fillStyle = c.accent;
      ctx.globalAlpha = 0.35;
      ctx.fillRect(x(s.sel[0]), top, Math.max(x(s.sel[1]) - x(s.sel[0]), 1), BAR);
      ctx.globalAlpha = 1;
    }
    const l = Math.max(x(s.view[0]), GUTTER.left),
      r = Math.min(x(s.view[1]), GUTTER.left + inner);
    ctx.fillStyle = c.accent;
    ctx.globalAlpha = 0.2;
    ctx.fillRect(l, top, Math.max(r - l, 2), BAR);
    ctx.globalAlpha = 1;
    ctx.fillRect(l, top, 2, BAR);
    ctx.fillRect(Math.max(r - 2, l), top, 2, BAR);
    ctx.fillStyle = c.dim;
    // marks the data if a live view extends beyond them
    const [first, last] = s.data.map(x);
    if (last - first < inner - 1) ctx.fillRect(first, top + BAR - 2, Math.max(last - first, 1), 2);
    ctx.font = FONT;
    ctx.textBaseline = "middle";
    const over = rulerTicks(this.shownSpan(), inner, this.app.client.origin, 110);
    for (const t of over.at) {
      const px = x(t);
      if (px > GUTTER.left + inner - 36) continue;
      ctx.fillRect(px, top + BAR - 4, 1, 4);
      ctx.fillText(formatClock(t, this.app.client.origin, over.unit), px + 4, top + BAR / 2 + 1);
    }
    ctx.fillStyle = c.accent;
    for (const b of listBookmarks(this.app))
      ctx.fillRect(x(b.from) - 1, top + BAR - 7, Math.max(x(b.to) - x(b.from), 3), 7);
    ctx.fillStyle = c.cursor;
    ctx.fillRect(x(s.cursor) - 0.5, top - 1, 1.5, BAR + 2);
    ctx.fillStyle = c.dim;
    ctx.textAlign = "right";
    ctx.fillText(formatDuration(s.data[1] - s.data[0]), GUTTER.left - 10, top + BAR / 2 + 1);

    this.app.gutter.reserveRoom(this, [formatDuration(s.data[1] - s.data[0]), formatDuration(s.view[1] - s.view[0])]);

    // ruler of the view
    const base = h - 1;
    const k = inner / (s.view[1] - s.view[0]);
    const viewToX = (t) => GUTTER.left + (t - s.view[0]) * k;
    const rule = rulerTicks(s.view, inner, this.app.client.origin);
    const tags = this.rulerTags(ctx, { s, vx: viewToX, inner, unit: rule.unit });
    ctx.textAlign = "center";
    ctx.fillStyle = c.axis;
    for (const t of rule.at) {
      const px = viewToX(t);
      ctx.globalAlpha = 0.6;
      ctx.fillRect(px, base - 5, 1, 5);
      ctx.globalAlpha = 1;
      const text = formatClock(t, this.app.client.origin, rule.unit);
      const half = ctx.measureText(text).width / 2;
      const at = Math.min(Math.max(px, GUTTER.left + half), w - half - 2);
      if (!tags.some((g) => Math.abs(g.at - at) < g.half + half + 3)) ctx.fillText(text, at, base - 12);
    }
    ctx.textAlign = "right";
    ctx.fillStyle = c.dim;
    ctx.fillText(formatDuration(s.view[1] - s.view[0]), GUTTER.left - 10, base - 12);
    this.drawSelection(ctx, { s, vx: viewToX, inner, base });
    for (const g of tags) drawTag(ctx, g, base);
    ctx.textAlign = "left";
    ctx.textBaseline = "alphabetic";
  }

  // Returns the tags on the ruler: the length of the selection, and the cursor's time with a higher precision.
  rulerTags(ctx, { s, vx, inner, unit }) {
    const c = themeColors();
    const [left, right] = [GUTTER.left, GUTTER.left + inner];
    const buildTag = (text, px, color) => {
      const half = ctx.measureText(text).width / 2 + 5;
      return { text, half, color, at: Math.min(Math.max(px, left + half), right - half) };
    };
    const [a, b] = this.selectionEnds(s, vx, inner);
    const out = b > a ? [buildTag(formatDuration(s.sel[1] - s.sel[0]), (a + b) / 2, c.accent)] : [];
    const at = vx(s.cursor);
    if (at >= left && at <= right)
      out.push(buildTag(formatClock(s.cursor, this.app.client.origin, unit / 100), at, c.cursor));
    return out;
  }

  // Returns the selection's ends on the ruler in pixels.
  selectionEnds(s, vx, inner) {
    if (s.mode === "live" || s.sel[0] == null || s.sel[1] == null) return [0, 0];
    return s.sel.map((t) => Math.min(Math.max(vx(t), GUTTER.left), GUTTER.left + inner));
  }

  drawSelection(ctx, { s, vx, inner, base }) {
    const [a, b] = this.selectionEnds(s, vx, inner);
    if (b <= a) return;
    ctx.fillStyle = themeColors().accent;
    ctx.fillRect(a, base - 4, b - a, 3);
  }

  cursorMoved() {
    this.app.scheduleDraw(this);
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
  }
}

function drawTag(ctx, { text, half, color, at }, base) {
  ctx.textAlign = "center";
  ctx.fillStyle = color;
  ctx.beginPath();
  ctx.roundRect(at - half, base - 20, 2 * half, 15, 3);
  ctx.fill();
  ctx.fillStyle = readableColor(color);
  ctx.fillText(text, at, base - 12);
}
