// Edges of annotations under the mouse or a finger, and the words about an annotation there.

import { duration } from "../time/text.js";
import { shown } from "../time/clock.js";

// How far, in pixels, an edge is from where it is taken; a finger is no point.
export const near = (e) => (e.pointerType === "touch" ? 14 : 5);

// An edge follows the mouse; the annotation that touches it goes along, but with the Alt key. It snaps to changes of
// the other panels, and to the messages of the stream that the cursor snaps to, but with the Shift key.
export function dragEdge(panel, e, item, edge) {
  const { el, app } = panel;
  e.stopImmediatePropagation();
  el.setPointerCapture(e.pointerId);
  const move = (m) => {
    const { t, px } = panel.place(m);
    panel.drag = { id: item.id, edge, t: m.shiftKey ? t : snapped(panel, t, px * near(m), item.id) };
    app.schedule(panel);
  };
  const end = (keep, m) => {
    for (const [name, f] of on) el.removeEventListener(name, f);
    const { drag } = panel;
    panel.drag = null;
    app.schedule(panel);
    if (!keep || !drag) return;
    const put = (t) => panel.moveEdge(item, edge, t, m.altKey);
    if (m.shiftKey) put(drag.t);
    else app.nearest(drag.t).then(put, () => put(drag.t));
  };
  // a touch that becomes a scroll moves nothing
  const on = [
    ["pointermove", move],
    ["pointerup", (m) => end(true, m)],
    ["pointercancel", (m) => end(false, m)],
  ];
  for (const [name, f] of on) el.addEventListener(name, f);
}

function snapped(panel, t, within, id) {
  let best = t,
    least = within;
  const own = panel.told.items.filter((a) => a.id !== id).flatMap((a) => [a.from, a.to]);
  const others = [...panel.app.views].filter((v) => v !== panel).flatMap((v) => v.changes?.() ?? []);
  for (const c of [...own, ...others]) if (Math.abs(c - t) < least) [best, least] = [c, Math.abs(c - t)];
  return best;
}

export function words(a, origin) {
  const show = (t) => shown(t, origin);
  const values = Object.entries(a.values).map(([name, v]) => `${name}: ${v}`);
  const about = [
    a.proposed ? "proposed" : "",
    a.by ? `by ${a.by}` : "",
    a.confidence != null ? `confidence ${a.confidence}` : "",
  ];
  const when =
    a.to === a.from ? `at ${show(a.from)}` : `${show(a.from)} to ${show(a.to)}, ${duration(a.to - a.from)}`;
  return [`${a.track}   ${when}`, ...values, about.filter(Boolean).join(", "), a.note ?? ""].filter(Boolean);
}
