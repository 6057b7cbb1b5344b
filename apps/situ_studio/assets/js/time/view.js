// The time model of the studio as a pure state machine: data, view, selection, cursor, playback, live mode. Times
// are Numbers: nanoseconds since the source's origin (exact up to 104 days).

export const LIVE_WINDOW = 30e9;
export const LIVE_CURSOR_AT = 0.8;
const MIN_VIEW = 1e3;
// The length of the view of a recording with a single moment, which is centered.
const POINT = 1e9;
const SEL_PADDING = 0.1;

export function initialState(from = 0, to = 60e9) {
  const data = dataExtent(from, to);
  return {
    data,
    // the times of the first and the last message
    messages: [from, to],
    view: data,
    sel: [null, null],
    cursor: from,
    mode: "manual",
    speed: 1,
    repeat: false,
    follow: true,
    play: null,
  };
}

const dataExtent = (from, to) => (to > from ? [from, to] : [from - POINT / 2, from + POINT / 2]);

/** @returns {[from: number, to: number]} */
export function nonEmptyRange(from, to) {
  return to > from ? [from, to] : [from, from + 1];
}

export const rangeWidth = ([from, to]) => to - from;

export function reduce(s, a) {
  const handler = handlers[a.type];
  return handler ? handler(s, a) : s;
}

const handlers = {
  // The extents of the data changed (opened, or grew while live).
  data(s, { from, to }) {
    const data = dataExtent(from, to);
    if (data[0] === s.data[0] && data[1] === s.data[1]) return s;
    const next = { ...s, data, messages: [from, to] };
    return s.mode === "live" ? followHead(next, data[1]) : next;
  },
  reset(s, { from, to }) {
    return { ...initialState(from, to), speed: s.speed, follow: s.follow };
  },
  restore(s, { view, cursor, sel, held }) {
    return {
      ...s,
      view: view ? nonEmptyRange(view[0], view[1]) : s.view,
      cursor: cursor ?? s.cursor,
      sel: sel ?? s.sel,
      follow: !held,
    };
  },

  // cursor
  move: (s, { t }) => (s.mode === "manual" && s.follow ? { ...s, cursor: t } : s),
  cursor: (s, { t }) => (s.mode === "live" ? s : { ...s, cursor: clamp(t, s.data) }),
  // Moving the cursor by hand leaves live mode; playback continues from there.
  nudge(s, { by }) {
    const cursor = clamp(s.cursor + by, s.data);
    if (s.mode === "play") return handlers.seek(s, { t: cursor });
    return scrollToCursor({ ...leaveLive(s), cursor, follow: false });
  },
  seek(s, { t }) {
    const cursor = clamp(t, s.data);
    if (s.mode !== "play") return { ...leaveLive(s), cursor };
    const [from, to] = s.play;
    // a new array even if the range is equal, so that the audio restarts, too
    return { ...s, cursor, play: cursor >= from && cursor < to ? [from, to] : nonEmptyRange(cursor, s.data[1]) };
  },
  goto(s, { t }) {
    const cursor = clamp(t, s.data);
    const half = rangeWidth(s.view) / 2;
    let from = cursor - half;
    if (from + 2 * half > s.data[1]) from = s.data[1] - 2 * half;
    if (from < s.data[0]) from = s.data[0];
    return { ...leaveLive(s), cursor, view: [from, from + 2 * half], follow: false };
  },
  follow: (s) => ({ ...s, follow: !s.follow }),

  // view
  view: (s, { from, to }) => ({ ...leaveLive(s), view: boundView(nonEmptyRange(from, to), s.data) }),
  zoomAt(s, { t, factor }) {
    if (s.mode === "live") return zoomLive(s, factor);
    const [from, to] = s.view;
    const w = Math.max((to - from) * factor, MIN_VIEW);
    const at = (t - from) / (to - from);
    const start = t - at * w;
    return { ...s, view: boundView([start, start + w], s.data) };
  },
  zoom(s, { factor }) {
    const mid = (s.view[0] + s.view[1]) / 2;
    return handlers.zoomAt(s, { t: mid, factor });
  },
  pan(s, { by }) {
    return { ...leaveLive(s), view: boundView([s.view[0] + by, s.view[1] + by], s.data) };
  },
  zoomAll: (s) => ({ ...leaveLive(s), view: s.data }),
  zoomSel(s) {
    const sel = finiteSel(s);
    if (!sel) return s;
    const pad = Math.max(rangeWidth(sel) * SEL_PADDING * 0.5, MIN_VIEW / 2);
    return { ...leaveLive(s), view: [sel[0] - pad, sel[1] + pad] };
  },

  // selection: both ends are optional; an end before the start is dropped
  selStart(s, { t }) {
    const end = s.sel[1];
    return { ...s, sel: [t, end != null && end >= t ? end : null] };
  },
  selEnd(s, { t }) {
    const start = s.sel[0];
    return { ...s, sel: [start != null && start <= t ? start : null, t] };
  },
  select: (s, { from, to }) => ({ ...s, sel: from <= to ? [from, to] : [to, from] }),
  clearSel: (s) => ({ ...s, sel: [null, null] }),
  shiftSel(s, { dir }) {
    const sel = finiteSel(s);
    if (!sel) return s;
    const w = rangeWidth(sel);
    let from = sel[0] + dir * w;
    from = Math.min(Math.max(from, s.data[0]), Math.max(s.data[1] - w, s.data[0]));
    const next = [from, from + w];
    let view = s.view;
    const vw = rangeWidth(view) <= w ? 1.1 * w : rangeWidth(view);
    if (next[1] > view[1] || vw !== rangeWidth(view)) view = [next[0] - 0.05 * vw, next[0] + 0.95 * vw];
    else if (next[0] < view[0]) view = [next[1] - 0.95 * vw, next[1] + 0.05 * vw];
    return { ...s, sel: next, view };
  },
  toSelStart: (s) => (s.sel[0] == null ? s : scrollToCursor(holdCursor(s, s.sel[0]))),
  toSelEnd: (s) => (s.sel[1] == null ? s : scrollToCursor(holdCursor(s, s.sel[1]))),

  // playback
  /** @param {any} s @param {{from: number, to: number, repeat?: boolean}} action */
  play(s, { from, to, repeat }) {
    const r = nonEmptyRange(from, to);
    return scrollToCursor({ ...s, mode: "play", play: r, cursor: from, repeat: repeat ?? s.repeat });
  },
  playView(s) {
    const ended = s.cursor >= s.data[1] - 1;
    // live data end at the newest time, so playback begins at the start of the view
    const start = !ended ? s.cursor : s.mode === "live" ? Math.max(s.view[0], s.data[0]) : s.data[0];
    return handlers.play(s, { from: start, to: s.data[1] });
  },
  playSel(s) {
    return handlers.play(s, { from: s.sel[0] ?? s.data[0], to: s.sel[1] ?? s.data[1] });
  },
  stop: (s) => (s.mode === "play" ? { ...s, mode: "manual", play: null, follow: false } : s),
  tick(s, { elapsed, at }) {
    if (s.mode !== "play") return s;
    const cursor = at ?? s.cursor + elapsed * s.speed;
    if (cursor < s.play[1]) return scrollToCursor({ ...s, cursor });
    if (s.repeat) return scrollToCursor({ ...s, cursor: s.play[0] });
    return { ...s, cursor: s.play[1], mode: "manual", play: null, follow: false };
  },
  speed: (s, { value }) => (value > 0 && Number.isFinite(value) ? { ...s, speed: value } : s),
  repeat: (s) => ({ ...s, repeat: !s.repeat }),

  // live: the cursor is the newest time, at 80 % of the view
  live(s, { on, width: liveWidth = LIVE_WINDOW }) {
    if (on === (s.mode === "live")) return s;
    if (!on) return leaveLive(s);
    const next = { ...s, mode: "live", play: null, liveWidth };
    return followHead(next, s.data[1]);
  },
};

function followHead(s, head) {
  const w = s.liveWidth ?? LIVE_WINDOW;
  const from = head - w * LIVE_CURSOR_AT;
  return { ...s, cursor: head, view: [from, from + w] };
}

function zoomLive(s, factor) {
  const liveWidth = Math.min(Math.max((s.liveWidth ?? LIVE_WINDOW) * factor, 1e6), 86400e9);
  return followHead({ ...s, liveWidth }, s.data[1]);
}

function leaveLive(s) {
  return s.mode === "live" ? { ...s, mode: "manual", follow: false } : s;
}

function holdCursor(s, cursor) {
  return { ...leaveLive(s), cursor, follow: false };
}

function scrollToCursor(s) {
  const w = rangeWidth(s.view);
  if (s.cursor >= s.view[0] && s.cursor <= s.view[1]) return s;
  const from = s.cursor - 0.2 * w;
  return { ...s, view: [from, from + w] };
}

// Limits the view: some data stay visible, and it is at most ten times as wide as the data.
function boundView([from, to], data) {
  const w = Math.min(to - from, Math.max(10 * rangeWidth(data), MIN_VIEW));
  const min = data[0] - 0.9 * w;
  const max = data[1] - 0.1 * w;
  const start = Math.min(Math.max(from, min), Math.max(max, min));
  return [start, start + w];
}

export function clamp(t, [from, to]) {
  return Math.min(Math.max(t, from), to);
}

export function finiteSel(s) {
  return s.sel[0] != null && s.sel[1] != null && s.sel[1] > s.sel[0] ? s.sel : null;
}

// A store with subscribers: one state, one place that changes it.
export function createStore(state = initialState()) {
  const listeners = new Set();
  return {
    get: () => state,
    dispatch(action) {
      const next = reduce(state, action);
      if (next === state) return state;
      const previous = state;
      state = next;
      for (const l of listeners) l(state, previous, action);
      return state;
    },
    subscribe(l) {
      listeners.add(l);
      return () => listeners.delete(l);
    },
  };
}
