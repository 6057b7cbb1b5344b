// The timing header and the states of the toolbar's buttons. Painted once per picture at most.

import { duration } from "../time/text.js";
import { day, nextClock, onClock, shown } from "../time/clock.js";

export class Header {
  // origin() -> the first time of the data as a BigInt, or null before there is any
  constructor(root, origin) {
    Object.assign(this, { root, origin, growing: false });
    onClock(() => this.state && this.update(this.state));
  }

  update(state) {
    this.state = state;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.paint(this.state);
    });
  }

  nextTiming() {
    nextClock();
  }

  // Whether what is shown is still being recorded.
  grows(growing) {
    this.growing = growing;
    if (this.state) this.update(this.state);
  }

  paint(s) {
    const origin = this.origin();
    if (origin === null) return;
    // as fine as what is looked at
    const w = s.view[1] - s.view[0];
    const unit = w < 1e5 ? 1 : w < 1e8 ? 1e3 : 1e6;
    const show = (t) => (t == null ? "–" : shown(t, origin, unit));
    this.set("t-from", day(s.cursor, origin));
    this.set("t-cursor", show(s.cursor));
    this.set("t-start", show(s.sel[0]));
    this.set("t-end", show(s.sel[1]));
    // where there is no selection to measure, the end of the data stands there
    const length = s.sel[0] != null && s.sel[1] != null;
    this.set("t-length-of", length ? "length" : "data ends");
    this.set("t-length", length ? duration(s.sel[1] - s.sel[0]) : lastMessageText(s, origin, show));
    this.set("speed", `${s.speed >= 1 ? Number(s.speed.toFixed(2)) : `1/${Number((1 / s.speed).toFixed(2))}`}×`);
    this.pressed("togglePlay", s.mode === "play");
    this.pressed("repeat", s.repeat);
    this.pressed("follow", s.follow);
    this.pressed("live", s.mode === "live");
    this.disabled(["live"], !this.growing && s.mode !== "live");
  }

  set(id, text) {
    const el = document.getElementById(id);
    if (el && el.textContent !== text) el.textContent = text;
  }

  pressed(act, on) {
    for (const b of this.root.querySelectorAll(`[data-act="${act}"]`)) b.setAttribute("aria-pressed", String(on));
  }

  disabled(acts, on) {
    for (const a of acts) for (const b of this.root.querySelectorAll(`[data-act="${a}"]`)) b.disabled = on;
  }
}

// A dash where there is no message: the page counts times from 0 then.
function lastMessageText({ messages: [from, to] }, origin, show) {
  return from === to && origin === 0n ? "–" : show(to);
}
