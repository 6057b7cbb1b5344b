// Handles the mouse on timeline panels: moving moves the cursor, dragging pans, the wheel zooms, Shift selects.

import { GUTTER } from "../page/theme.js";
import { readSetting } from "../page/settings.js";

// How close to a change the edge of a selection must be to snap, in pixels.
const NEAR = 6;

/**
 * @typedef {object} Drag
 * @property {number} x
 * @property {[number, number]} view
 * @property {number} t
 * @property {boolean} select
 * @property {boolean} free
 * @property {number} inner
 * @property {boolean} moved
 */

export function timelineGestures(el, app, view) {
  const locatePointer = (e) => {
    const box = el.getBoundingClientRect();
    const inner = box.width - GUTTER.left - GUTTER.right;
    const s = app.time.get();
    const x = e.clientX - box.left - GUTTER.left;
    return { t: s.view[0] + (x / inner) * (s.view[1] - s.view[0]), ok: x >= 0 && x <= inner, inner };
  };
  /** @type {{drag: Drag | null}} */
  const state = { drag: null };

  // Snaps the edges of a selection to changes within a few pixels, unless Alt is held.
  const snapTime = (t, drag) => {
    if (drag.free) return t;
    const s = app.time.get();
    const near = ((s.view[1] - s.view[0]) / drag.inner) * NEAR;
    let best = t,
      least = near;
    for (const v of app.views) {
      for (const c of v.changeTimes?.() ?? []) if (Math.abs(c - t) < least) [best, least] = [c, Math.abs(c - t)];
    }
    return best;
  };

  const handleMove = (e) => {
    const at = locatePointer(e);
    const d = state.drag;
    if (d) {
      if (Math.abs(e.clientX - d.x) > 3) d.moved = true;
      if (!d.moved) return;
      const w = d.view[1] - d.view[0];
      if (d.select) app.time.dispatch({ type: "select", from: snapTime(d.t, d), to: snapTime(at.t, d) });
      else {
        const by = ((e.clientX - d.x) / at.inner) * w;
        app.time.dispatch({ type: "view", from: d.view[0] - by, to: d.view[1] - by });
      }
      return;
    }
    if (at.ok && !e.shiftKey) app.time.dispatch({ type: "move", t: at.t });
  };
  const handleDown = (e) => {
    const at = locatePointer(e);
    // buttons and fields keep their clicks
    if (!at.ok || e.button !== 0 || e.target.closest("button, select, input")) return;
    el.setPointerCapture(e.pointerId);
    state.drag = {
      x: e.clientX,
      view: app.time.get().view,
      t: at.t,
      select: e.shiftKey,
      free: e.altKey,
      inner: at.inner,
      moved: false,
    };
  };
  const handleUp = (e) => {
    const d = state.drag;
    state.drag = null;
    if (!d || d.moved) return;
    // a click on an interval selects it
    const found = d.select ? null : view?.segmentUnder?.(e);
    if (found) app.time.dispatch({ type: "select", from: found[0], to: found[1] });
    if (d.select) app.time.dispatch({ type: "selStart", t: d.t });
    else if (app.time.get().mode === "play" || !app.time.get().follow) app.time.dispatch({ type: "seek", t: d.t });
    else app.selectPanelOf(e.target);
  };
  const handleMenu = (e) => {
    if (!e.shiftKey) return;
    e.preventDefault();
    app.time.dispatch({ type: "selEnd", t: locatePointer(e).t });
  };
  const handleWheel = (e) => {
    if (e.ctrlKey !== (readSetting("wheel") === "scroll")) return;
    const at = locatePointer(e);
    if (!at.ok) return;
    e.preventDefault();
    if (Math.abs(e.deltaX) > Math.abs(e.deltaY)) {
      const s = app.time.get();
      app.time.dispatch({ type: "pan", by: (e.deltaX / at.inner) * (s.view[1] - s.view[0]) });
      return;
    }
    const factor = 1 + Math.min(Math.max(e.deltaY / 200, -0.2), 0.2);
    app.time.dispatch({ type: "zoomAt", t: at.t, factor });
  };
  const on = [
    ["pointermove", handleMove],
    ["pointerdown", handleDown],
    ["pointerup", handleUp],
    ["pointercancel", handleUp],
    ["contextmenu", handleMenu],
  ];
  for (const [name, f] of on) el.addEventListener(name, f);
  el.addEventListener("wheel", handleWheel, { passive: false });
}
