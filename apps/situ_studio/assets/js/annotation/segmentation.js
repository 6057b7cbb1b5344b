// Segmentation by one key: while it is on, Enter marks the boundaries of annotations during playback.

import { showToast } from "../page/toast.js";

// The ways of marking boundaries, in the order in which the button switches.
export const SEGMENTATIONS = [
  ["off", "Segment"],
  ["pairs", "Segment: start, end"],
  ["chain", "Segment: without gaps"],
];

/** @typedef {{mode: string, from: number | null}} Marks `from` is the start of the annotation that is not finished */

// Returns the marks after Enter at a time, and the finished annotation or null.
/** @param {Marks} marks @param {number} t @returns {[Marks, {from: number, to: number} | null]} */
export function markBoundary({ mode, from }, t) {
  if (from == null || t === from) return [{ mode, from: t }, null];
  const segment = { from: Math.min(from, t), to: Math.max(from, t) };
  return [{ mode, from: mode === "chain" ? t : null }, segment];
}

export class Segmentation {
  constructor(panel) {
    this.panel = panel;
    /** @type {Marks} */
    this.marks = { mode: "off", from: null };
  }

  get active() {
    return this.marks.mode !== "off";
  }

  switchMode() {
    const at = SEGMENTATIONS.findIndex(([mode]) => mode === this.marks.mode);
    this.marks = { mode: SEGMENTATIONS[(at + 1) % SEGMENTATIONS.length][0], from: null };
    if (this.active) showToast("Play (Space), and press Enter at each boundary. Escape drops the last one");
    this.panel.tools.update();
    this.panel.app.scheduleDraw(this.panel);
  }

  // Handles a key of the page; returns true if it was handled.
  handleKeyDown(e) {
    if (!this.active || e.ctrlKey || e.metaKey || e.altKey) return false;
    if (e.key === "Escape") {
      if (this.marks.from == null) this.marks = { mode: "off", from: null };
      else this.marks = { ...this.marks, from: null };
      this.panel.tools.update();
    } else if (e.key === "Enter" && !e.repeat) this.mark(this.panel.app.time.get().cursor);
    else return false;
    this.panel.app.scheduleDraw(this.panel);
    return true;
  }

  mark(t) {
    const [marks, segment] = markBoundary(this.marks, t);
    this.marks = marks;
    if (segment) this.panel.addAnnotation(segment.from, segment.to);
  }

  // The annotation that is not finished, up to the cursor, as a list.
  pendingAnnotations(cursor) {
    const { from } = this.marks;
    return from == null ? [] : [{ from: Math.min(from, cursor), to: Math.max(from, cursor), values: {} }];
  }
}
