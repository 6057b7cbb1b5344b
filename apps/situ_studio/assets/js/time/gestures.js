// Mouse on timeline panels: move = cursor, drag = pan, wheel = zoom, Shift = selection.

import { GUTTER } from "../page/theme.js";

export function timelineGestures(el, app) {
  const inside = (e) => {
    const box = el.getBoundingClientRect();
    const inner = box.width - GUTTER.left - GUTTER.right;
    const s = app.time.get();
    const x = e.clientX - box.left - GUTTER.left;
    return { t: s.view[0] + (x / inner) * (s.view[1] - s.view[0]), ok: x >= 0 && x <= inner, inner };
  };
  const state = { drag: null };

  const move = (e) => {
    const at = inside(e);
    const d = state.drag;
    if (d) {
      if (Math.abs(e.clientX - d.x) > 3) d.moved = true;
      if (!d.moved) return;
      const w = d.view[1] - d.view[0];
      if (d.select) app.time.dispatch({ type: "select", from: d.t, to: at.t });
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
    if (!at.ok || e.button !== 0) return;
    el.setPointerCapture(e.pointerId);
    state.drag = { x: e.clientX, view: app.time.get().view, t: at.t, select: e.shiftKey, moved: false };
  };
  const up = (e) => {
    const d = state.drag;
    state.drag = null;
    if (!d || d.moved) return;
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
    if (e.ctrlKey) return;
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
  const on = [["pointermove", move], ["pointerdown", down], ["pointerup", up], ["pointercancel", up], ["contextmenu", menu]];
  for (const [name, f] of on) el.addEventListener(name, f);
  el.addEventListener("wheel", wheel, { passive: false });
}
