// Mouse on timeline panels: move = cursor, drag = pan, wheel = zoom, Shift = selection.

import { GUTTER } from "../page/theme.js";
import { setting } from "../page/settings.js";

// How far, in pixels, an edge of a selection is from what it snaps to.
const NEAR = 6;

export function timelineGestures(el, app, view) {
  const inside = (e) => {
    const box = el.getBoundingClientRect();
    const inner = box.width - GUTTER.left - GUTTER.right;
    const s = app.time.get();
    const x = e.clientX - box.left - GUTTER.left;
    return { t: s.view[0] + (x / inner) * (s.view[1] - s.view[0]), ok: x >= 0 && x <= inner, inner };
  };
  const state = { drag: null };

  // Edges of a selection go to where something begins or ends, within a few pixels; not with the Alt key.
  const snap = (t, drag) => {
    if (drag.free) return t;
    const s = app.time.get();
    const near = ((s.view[1] - s.view[0]) / drag.inner) * NEAR;
    let best = t,
      least = near;
    for (const v of app.views) {
      for (const c of v.changes?.() ?? []) if (Math.abs(c - t) < least) [best, least] = [c, Math.abs(c - t)];
    }
    return best;
  };

  const move = (e) => {
    const at = inside(e);
    const d = state.drag;
    if (d) {
      if (Math.abs(e.clientX - d.x) > 3) d.moved = true;
      if (!d.moved) return;
      const w = d.view[1] - d.view[0];
      if (d.select) app.time.dispatch({ type: "select", from: snap(d.t, d), to: snap(at.t, d) });
      else {
        const by = ((e.clientX - d.x) / at.inner) * w;
        app.time.dispatch({ type: "view", from: d.view[0] - by, to: d.view[1] - by });
      }
      return;
    }
    if (at.ok && !e.shiftKey) app.time.dispatch({ type: "move", t: at.t });
  };
  const down = (e) => {
    const at = inside(e);
    // what can be clicked keeps its clicks
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
  const up = (e) => {
    const d = state.drag;
    state.drag = null;
    if (!d || d.moved) return;
    // an interval that is clicked is selected
    const found = d.select ? null : view?.segment?.(e);
    if (found) app.time.dispatch({ type: "select", from: found[0], to: found[1] });
    if (d.select) app.time.dispatch({ type: "selStart", t: d.t });
    else if (app.time.get().mode === "play" || !app.time.get().follow) app.time.dispatch({ type: "seek", t: d.t });
    else app.selectPanelOf(e.target);
  };
  const menu = (e) => {
    if (!e.shiftKey) return;
    e.preventDefault();
    app.time.dispatch({ type: "selEnd", t: inside(e).t });
  };
  const wheel = (e) => {
    if (e.ctrlKey !== (setting("wheel") === "scroll")) return;
    const at = inside(e);
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
    ["pointermove", move],
    ["pointerdown", down],
    ["pointerup", up],
    ["pointercancel", up],
    ["contextmenu", menu],
  ];
  for (const [name, f] of on) el.addEventListener(name, f);
  el.addEventListener("wheel", wheel, { passive: false });
}
