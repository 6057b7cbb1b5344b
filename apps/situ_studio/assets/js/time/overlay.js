// Shows the cursor line and the selection over a timeline panel. Only transforms change, so that no layout is
// needed.

import { GUTTER } from "../page/theme.js";
import { OwnRuler } from "./own_ruler.js";

export class Overlay {
  constructor(el, app) {
    this.el = el;
    this.box = el.appendChild(document.createElement("div"));
    this.box.className = "overlay";
    const addMark = (className) => Object.assign(this.box.appendChild(document.createElement("div")), { className });
    this.shade = addMark("sel-shade");
    this.start = addMark("sel-line start");
    this.end = addMark("sel-line end");
    this.cursor = addMark("cursor-line");
    this.ruler = app && new OwnRuler(this.box, app);
  }

  update(s) {
    const width = this.el.clientWidth;
    const inner = width - GUTTER.left - GUTTER.right;
    if (inner <= 0) return;
    this.ruler?.update(s.view, inner, width);
    const k = inner / (s.view[1] - s.view[0]);
    const timeToX = (t) => (t - s.view[0]) * k;
    placeLine(this.cursor, timeToX(s.cursor), inner);
    placeLine(this.start, s.sel[0] == null ? null : timeToX(s.sel[0]), inner);
    placeLine(this.end, s.sel[1] == null ? null : timeToX(s.sel[1]), inner);
    const both = s.sel[0] != null && s.sel[1] != null;
    this.shade.hidden = !both;
    if (both) {
      const a = Math.max(timeToX(s.sel[0]), 0),
        b = Math.min(timeToX(s.sel[1]), inner);
      this.shade.hidden = b <= a;
      this.shade.style.transform = `translateX(${a}px)`;
      this.shade.style.width = `${Math.max(b - a, 0)}px`;
    }
  }
}

function placeLine(el, x, inner) {
  const show = x != null && x >= 0 && x <= inner;
  el.hidden = !show;
  if (show) el.style.transform = `translateX(${x}px)`;
}
