// The time model of the studio as a pure state machine: data, view, selection, cursor, playback, live.
// Times are Numbers: nanoseconds since the source's origin (exact up to 104 days).

export const LIVE_WINDOW = 30e9;
export const LIVE_CURSOR_AT = 0.8;
const MIN_VIEW = 1e3;
// The length of the window on a recording that is one moment long, which is in the middle.
const POINT = 1e9;
const SEL_PADDING = 0.1;

export function initial(from = 0, to = 60e9) {
  const data = extent(from, to);
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

const extent = (from, to) => (to > from ? [from, to] : [from - POINT / 2, from + POINT / 2]);

export function range(from, to) {
  return to > from ? [from, to] : [from, from + 1];
}

export const width = ([from, to]) => to - from;

export function reduce(s, a) {
  const handler = handlers[a.type];
  return handler ? handler(s, a) : s;
}

const handlers = {
  // The extents of the data changed (opened, or grew while live).
  data(s, { from, to }) {
    const data = extent(from, to);
    if (data[0] === s.data[0] && data[1] === s.data[1]) return s;
    const next = { ...s, data, messages: [from, to] };
    return s.mode === "live" ? follow(next, data[1]) : next;
  },
  reset(s, { from, to }) {
    return { ...initial(from, to), speed: s.speed, follow: s.follow };
  },
  restore(s, { view, cursor, sel, held }) {
    return {
      ...s,
      view: view ? range(view[0], view[1]) : s.view,
      cursor: cursor ?? s.cursor,
      sel: sel ?? s.sel,
      follow: !held,
    };
  },

  // cursor
  move: (s, { t }) => (s.mode === "manual" && s.follow ? { ...s, cursor: t } : s),
  cursor: (s, { t }) => (s.mode === "live" ? s : { ...s, cursor: clamp(t, s.data) }),
  // Who moves the cursor by hand leaves the newest time; playing goes on from there.
  nudge(s, { by }) {
    const cursor = clamp(s.cursor + by, s.data);
    if (s.mode === "play") return handlers.seek(s, { t: cursor });
    return visible({ ...leaveLive(s), cursor, follow: false });
  },
  seek(s, { t }) {
    const cursor = clamp(t, s.data);
    if (s.mode !== "play") return { ...leaveLive(s), cursor };
    const [from, to] = s.play;
    // another range, if only by its identity: the sound begins there, too
    return { ...s, cursor, play: cursor >= from && cursor < to ? [from, to] : range(cursor, s.data[1]) };
  },
  goto(s, { t }) {
    const cursor = clamp(t, s.data);
    const half = width(s.view) / 2;
    let from = cursor - half;
    if (from + 2 * half > s.data[1]) from = s.data[1] - 2 * half;
    if (from < s.data[0]) from = s.data[0];
    return { ...leaveLive(s), cursor, view: [from, from + 2 * half], follow: false };
  },
  follow: (s) => ({ ...s, follow: !s.follow }),

  // view
  view: (s, { from, to }) => ({ ...leaveLive(s), view: bound(range(from, to), s.data) }),
  zoomAt(s, { t, factor }) {
    if (s.mode === "live") return zoomLive(s, factor);
    const [from, to] = s.view;
    const w = Math.max((to - from) * factor, MIN_VIEW);
    const at = (t - from) / (to - from);
    const start = t - at * w;
    return { ...s, view: bound([start, start + w], s.data) };
  },
  zoom(s, { factor }) {
    const mid = (s.view[0] + s.view[1]) / 2;
    return handlers.zoomAt(s, { t: mid, factor });
  },
  pan(s, { by }) {
    return { ...leaveLive(s), view: bound([s.view[0] + by, s.view[1] + by], s.data) };
  },
  zoomAll: (s) => ({ ...leaveLive(s), view: s.data }),
  zoomSel(s) {
    const sel = finiteSel(s);
    if (!sel) return s;
    const pad = Math.max(width(sel) * SEL_PADDING * 0.5, MIN_VIEW / 2);
    return { ...leaveLive(s), view: [sel[0] - pad, sel[1] + pad] };
  },

  // selection: both ends are optional; an end that would lie before the start is dropped
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
    const w = width(sel);
    let from = sel[0] + dir * w;
    from = Math.min(Math.max(from, s.data[0]), Math.max(s.data[1] - w, s.data[0]));
    const next = [from, from + w];
    let view = s.view;
    const vw = width(view) <= w ? 1.1 * w : width(view);
    if (next[1] > view[1] || vw !== width(view)) view = [next[0] - 0.05 * vw, next[0] + 0.95 * vw];
    else if (next[0] < view[0]) view = [next[1] - 0.95 * vw, next[1] + 0.05 * vw];
    return { ...s, sel: next, view };
  },
  toSelStart: (s) => (s.sel[0] == null ? s : visible(still(s, s.sel[0]))),
  toSelEnd: (s) => (s.sel[1] == null ? s : visible(still(s, s.sel[1]))),

  // playback
  play(s, { from, to, repeat }) {
    const r = range(from, to);
    return visible({ ...s, mode: "play", play: r, cursor: from, repeat: repeat ?? s.repeat });
  },
  playView(s) {
    const ended = s.cursor >= s.data[1] - 1;
    // what is live ends at its newest time: playing begins where the view does
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
    if (cursor < s.play[1]) return visible({ ...s, cursor });
    if (s.repeat) return visible({ ...s, cursor: s.play[0] });
    return { ...s, cursor: s.play[1], mode: "manual", play: null, follow: false };
  },
  speed: (s, { value }) => (value > 0 && Number.isFinite(value) ? { ...s, speed: value } : s),
  repeat: (s) => ({ ...s, repeat: !s.repeat }),

  // live: the cursor is the newest time, at 80 % of the view
  live(s, { on, width: liveWidth = LIVE_WINDOW }) {
    if (on === (s.mode === "live")) return s;
    if (!on) return leaveLive(s);
    const next = { ...s, mode: "live", play: null, liveWidth };
    return follow(next, s.data[1]);
  },
};

function follow(s, head) {
  const w = s.liveWidth ?? LIVE_WINDOW;
  const from = head - w * LIVE_CURSOR_AT;
  return { ...s, cursor: head, view: [from, from + w] };
}

function zoomLive(s, factor) {
  const liveWidth = Math.min(Math.max((s.liveWidth ?? LIVE_WINDOW) * factor, 1e6), 86400e9);
  return follow({ ...s, liveWidth }, s.data[1]);
}

function leaveLive(s) {
  return s.mode === "live" ? { ...s, mode: "manual", follow: false } : s;
}

function still(s, cursor) {
  return { ...leaveLive(s), cursor, follow: false };
}

function visible(s) {
  const w = width(s.view);
  if (s.cursor >= s.view[0] && s.cursor <= s.view[1]) return s;
  const from = s.cursor - 0.2 * w;
  return { ...s, view: [from, from + w] };
}

// Some of the data stays in the view, and a view is at most ten times as wide as the data.
function bound([from, to], data) {
  const w = Math.min(to - from, Math.max(10 * width(data), MIN_VIEW));
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
export function createStore(state = initial()) {
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
