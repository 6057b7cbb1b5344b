// Drags the edges of annotations with the mouse or a finger, and describes the annotation under the pointer.

import { formatDuration } from "../time/text.js";
import { formatClock } from "../time/clock.js";

// Returns how close to an edge the pointer must be, in pixels. Fingers get more room.
export const edgeReach = (e) => (e.pointerType === "touch" ? 14 : 5);

// Drags an edge. An adjacent annotation that touches it moves along, unless Alt is held. The edge snaps to changes
// in other panels and to messages of the snapped stream, unless Shift is held.
export function dragEdge(panel, e, item, edge) {
  const { el, app } = panel;
  e.stopImmediatePropagation();
  el.setPointerCapture(e.pointerId);
  const moveEdge = (m) => {
    const { t, px } = panel.locatePointer(m);
    panel.drag = { id: item.id, edge, t: m.shiftKey ? t : snapTime(panel, t, px * edgeReach(m), item.id) };
    app.scheduleDraw(panel);
  };
  const finishDrag = (keep, m) => {
    for (const [name, f] of on) el.removeEventListener(name, f);
    const { drag } = panel;
    panel.drag = null;
    app.scheduleDraw(panel);
    if (!keep || !drag) return;
    // with Ctrl, everything beyond the edge moves along
    const applyEdge = (t) =>
      m.ctrlKey || m.metaKey ? panel.rippleEdge(item, edge, t) : panel.moveEdge(item, edge, t, m.altKey);
    if (m.shiftKey) applyEdge(drag.t);
    else app.nearestMessageTime(drag.t).then(applyEdge, () => applyEdge(drag.t));
  };
  // a touch that turns into scrolling moves nothing
  const on = [
    ["pointermove", moveEdge],
    ["pointerup", (m) => finishDrag(true, m)],
    ["pointercancel", (m) => finishDrag(false, m)],
  ];
  for (const [name, f] of on) el.addEventListener(name, f);
}

function snapTime(panel, t, within, id) {
  let best = t,
    least = within;
  const own = panel.state.items.filter((a) => a.id !== id).flatMap((a) => [a.from, a.to]);
  const others = [...panel.app.views].filter((v) => v !== panel).flatMap((v) => v.changeTimes?.() ?? []);
  for (const c of [...own, ...others]) if (Math.abs(c - t) < least) [best, least] = [c, Math.abs(c - t)];
  return best;
}

export function describeAnnotation(a, origin) {
  const formatTime = (t) => formatClock(t, origin);
  const values = Object.entries(a.values).map(([name, v]) => `${name}: ${v}`);
  const about = [
    a.proposed ? "proposed" : "",
    a.by ? `by ${a.by}` : "",
    a.confidence != null ? `confidence ${a.confidence}` : "",
  ];
  const when =
    a.to === a.from
      ? `at ${formatTime(a.from)}`
      : `${formatTime(a.from)} to ${formatTime(a.to)}, ${formatDuration(a.to - a.from)}`;
  return [`${a.track}   ${when}`, ...values, about.filter(Boolean).join(", "), a.note ?? ""].filter(Boolean);
}
