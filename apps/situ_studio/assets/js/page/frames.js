// Drawing, and its moments: views that changed are drawn once per picture of the browser.

import { Overlay } from "../time/overlay.js";
import { describe } from "./alternative.js";

export class Frames {
  constructor(time) {
    this.time = time;
    this.views = new Set();
    this.dirty = new Set();
    this.overlays = new Map();
    this.drawn = { count: 0, since: performance.now() };
  }

  // A view has render() and, when it draws times, cursorMoved(); `timeline` views get cursor and selection lines.
  add(view, { timeline = false } = {}) {
    this.views.add(view);
    view.timeline = timeline;
    if (timeline) {
      const overlay = new Overlay(view.el);
      this.overlays.set(view, overlay);
      overlay.update(this.time.get());
    }
    this.schedule(view);
  }

  remove(view) {
    this.views.delete(view);
    this.dirty.delete(view);
    this.overlays.delete(view);
    view.destroy?.();
  }

  schedule(view) {
    this.dirty.add(view);
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = null;
      const views = [...this.dirty];
      this.dirty.clear();
      for (const v of views) {
        if (!this.views.has(v)) continue;
        v.render();
        // a panel that has become wider or narrower has its lines elsewhere
        this.overlays.get(v)?.update(this.time.get());
        describe(v, () => this.time.get());
      }
      this.drawn.count++;
    });
  }

  // The times have changed.
  moved(s, old) {
    const viewChanged = s.view !== old.view || s.data !== old.data;
    for (const o of this.overlays.values()) o.update(s);
    for (const v of this.views) {
      if ((v.timeline || v.windowed) && viewChanged) this.schedule(v);
      else if (s.cursor !== old.cursor) v.cursorMoved();
      if (v.navigator) this.schedule(v);
    }
  }

  // Pictures a second since the last call.
  rate() {
    const now = performance.now();
    const fps = (this.drawn.count * 1000) / (now - this.drawn.since);
    this.drawn = { count: 0, since: now };
    return fps;
  }
}
