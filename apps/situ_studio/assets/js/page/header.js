// Updates the timing header and the states of the toolbar's buttons, at most once per animation frame.

import { formatDuration } from "../time/text.js";
import { formatDay, nextClock, onClock, formatClock } from "../time/clock.js";

export class Header {
  // origin() -> the first time of the data as a BigInt, or null before there are data
  constructor(root, origin) {
    this.root = root;
    this.origin = origin;
    this.growing = false;
    onClock(() => this.state && this.update(this.state));
  }

  update(state) {
    this.state = state;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.paintState(this.state);
    });
  }

  nextTiming() {
    nextClock();
  }

  // Sets whether the source is still being recorded.
  setGrowing(growing) {
    this.growing = growing;
    if (this.state) this.update(this.state);
  }

  paintState(s) {
    const origin = this.origin();
    if (origin === null) return;
    // the precision follows the width of the view
    const w = s.view[1] - s.view[0];
    const unit = w < 1e5 ? 1 : w < 1e8 ? 1e3 : 1e6;
    const formatTime = (t) => (t == null ? "–" : formatClock(t, origin, unit));
    this.setText("t-from", formatDay(s.cursor, origin));
    this.setText("t-cursor", formatTime(s.cursor));
    this.setText("t-start", formatTime(s.sel[0]));
    this.setText("t-end", formatTime(s.sel[1]));
    // without a selection, the end of the data is shown instead of a length
    const length = s.sel[0] != null && s.sel[1] != null;
    this.setText("t-length-of", length ? "length" : "data ends");
    this.setText("t-length", length ? formatDuration(s.sel[1] - s.sel[0]) : lastMessageText(s, origin, formatTime));
    this.setText("speed", `${s.speed >= 1 ? Number(s.speed.toFixed(2)) : `1/${Number((1 / s.speed).toFixed(2))}`}×`);
    this.setPressed("togglePlay", s.mode === "play");
    this.setPressed("repeat", s.repeat);
    this.setPressed("follow", s.follow);
    this.setPressed("live", s.mode === "live");
    this.setDisabled(["live"], !this.growing && s.mode !== "live");
  }

  setText(id, text) {
    const el = document.getElementById(id);
    if (el && el.textContent !== text) el.textContent = text;
  }

  setPressed(act, on) {
    for (const b of this.root.querySelectorAll(`[data-act="${act}"]`)) b.setAttribute("aria-pressed", String(on));
  }

  setDisabled(acts, on) {
    for (const a of acts) for (const b of this.root.querySelectorAll(`[data-act="${a}"]`)) b.disabled = on;
  }
}

// Returns a dash if there is no message, since the page counts times from 0 then.
function lastMessageText({ messages: [from, to] }, origin, show) {
  return from === to && origin === 0n ? "–" : show(to);
}
