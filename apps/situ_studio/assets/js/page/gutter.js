// The room beside the timelines for names and numbers: as much as the widest needs, for all panels the same, so that a
// time is at the same place in each.

import { FONT, GUTTER } from "./theme.js";

const LEAST = 56,
  MOST = 200,
  SHARE = 0.25,
  SPACE = 14;
const ruler = document.createElement("canvas").getContext("2d");

export function textWidth(text) {
  ruler.font = FONT;
  return ruler.measureText(text).width;
}

// As much of a text as there is room for.
export function fitted(ctx, text, width) {
  let t = text;
  while (t.length > 2 && ctx.measureText(t).width > width) t = `${t.slice(0, -2)}…`;
  return t;
}

export class Gutter {
  // changed() when all panels have to be drawn again
  constructor(changed) {
    this.changed = changed;
    this.needs = new Map();
    this.apply(LEAST);
  }

  // A panel tells which texts stand in its gutter; null when it is gone.
  need(panel, texts) {
    const width = texts === null ? null : Math.max(0, ...texts.map(textWidth)) + SPACE;
    if (width === null) this.needs.delete(panel);
    else if (Math.abs((this.needs.get(panel) ?? -1) - width) < 1) return;
    else this.needs.set(panel, width);
    const room = document.getElementById("navigator")?.clientWidth || MOST / SHARE;
    const most = Math.max(LEAST, Math.min(MOST, room * SHARE));
    const wanted = Math.ceil(Math.min(Math.max(LEAST, ...this.needs.values()), most) / 4) * 4;
    // a little less is no reason to move everything
    if (wanted > GUTTER.left || wanted < GUTTER.left - 24) this.apply(wanted);
  }

  get left() {
    return GUTTER.left;
  }

  apply(px) {
    if (GUTTER.left === px && this.applied) return;
    GUTTER.left = px;
    this.applied = true;
    document.documentElement.style.setProperty("--gutter", `${px}px`);
    this.changed();
  }
}
