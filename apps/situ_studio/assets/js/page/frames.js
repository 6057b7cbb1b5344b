// Schedules drawing: views that changed are drawn once per animation frame.

import { Overlay } from "../time/overlay.js";
import { scheduleLabel } from "./canvas_label.js";

export class Frames {
  constructor(time) {
    this.time = time;
    this.views = new Set();
    this.dirty = new Set();
    this.overlays = new Map();
    this.drawn = { count: 0, since: performance.now() };
  }

  // A view has render() and cursorMoved(); `timeline` views get cursor and selection lines.
  addView(view, { timeline = false } = {}) {
    this.views.add(view);
    view.timeline = timeline;
    if (timeline) {
      const overlay = new Overlay(view.el, view.app);
      this.overlays.set(view, overlay);
      overlay.update(this.time.get());
    }
    this.scheduleDraw(view);
  }

  removeView(view) {
    this.views.delete(view);
    this.dirty.delete(view);
    this.overlays.delete(view);
    view.destroy?.();
  }

  scheduleDraw(view) {
    this.dirty.add(view);
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = null;
      const views = [...this.dirty];
      this.dirty.clear();
      for (const v of views) if (this.views.has(v)) this.drawView(v);
      this.drawn.count++;
    });
  }

  // The error of one view must not keep the others from being drawn.
  drawView(view) {
    try {
      view.render();
      // the lines of a resized panel are elsewhere
      this.overlays.get(view)?.update(this.time.get());
      scheduleLabel(view, () => this.time.get());
    } catch (error) {
      reportError(error);
    }
  }

  // Schedules the views that depend on the changed times.
  updateTimes(s, old) {
    const viewChanged = s.view !== old.view || s.data !== old.data;
    for (const o of this.overlays.values()) o.update(s);
    for (const v of this.views) {
      if ((v.timeline || v.windowed) && viewChanged) this.scheduleDraw(v);
      else if (s.cursor !== old.cursor) v.cursorMoved();
      if (v.navigator) this.scheduleDraw(v);
    }
  }

  // Returns the frame rate since the last call.
  frameRate() {
    const now = performance.now();
    const fps = (this.drawn.count * 1000) / (now - this.drawn.since);
    this.drawn = { count: 0, since: now };
    return fps;
  }
}
