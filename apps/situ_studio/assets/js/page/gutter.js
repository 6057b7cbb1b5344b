// The space to the left of the timelines for names and numbers. It is as wide as the widest text needs and the same
// for all panels, so that times are aligned.

import { FONT, GUTTER } from "./theme.js";
import { getContext2d } from "./dom.js";

const LEAST = 56,
  MOST = 200,
  SHARE = 0.25,
  SPACE = 14;
const ruler = getContext2d(document.createElement("canvas"));

export function textWidth(text) {
  ruler.font = FONT;
  return ruler.measureText(text).width;
}

// Shortens a text to fit a width.
export function truncateText(ctx, text, width) {
  let t = text;
  while (t.length > 2 && ctx.measureText(t).width > width) t = `${t.slice(0, -2)}…`;
  return t;
}

export class Gutter {
  // changed() is called when all panels have to be redrawn
  constructor(changed) {
    this.changed = changed;
    this.needs = new Map();
    this.setWidth(LEAST);
  }

  // Reserves the space for a panel's texts; null when the panel is removed.
  reserveRoom(panel, texts) {
    const width = texts === null ? null : Math.max(0, ...texts.map(textWidth)) + SPACE;
    if (width === null) this.needs.delete(panel);
    else if (Math.abs((this.needs.get(panel) ?? -1) - width) < 1) return;
    else this.needs.set(panel, width);
    const room = document.getElementById("navigator")?.clientWidth || MOST / SHARE;
    const most = Math.max(LEAST, Math.min(MOST, room * SHARE));
    const wanted = Math.ceil(Math.min(Math.max(LEAST, ...this.needs.values()), most) / 4) * 4;
    // slightly less space is not worth moving everything
    if (wanted > GUTTER.left || wanted < GUTTER.left - 24) this.setWidth(wanted);
  }

  get left() {
    return GUTTER.left;
  }

  setWidth(px) {
    if (GUTTER.left === px && this.applied) return;
    GUTTER.left = px;
    this.applied = true;
    document.documentElement.style.setProperty("--gutter", `${px}px`);
    this.changed();
  }
}
