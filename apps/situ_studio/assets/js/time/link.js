// Encodes layout, view, cursor and selection in the address. Times are absolute nanoseconds, so that a copied link
// shows the same anywhere.

/**
 * @param {any} s
 * @param {bigint} origin
 * @param {{layout?: string, edit?: string, snap?: string | null, annotate?: string, compare?: any}} facts
 */
export function encodeLink(s, origin, { layout, edit, snap, annotate, compare } = {}) {
  const toAbsolute = (t) => (origin + BigInt(Math.round(t))).toString();
  const q = new URLSearchParams();
  if (layout) q.set("layout", layout);
  if (edit) q.set("edit", edit);
  if (snap) q.set("snap", snap);
  if (annotate) q.set("annotate", annotate);
  if (compare) {
    q.set("with", compare.el.dataset.with);
    q.set("offset", compare.offset.toString());
  }
  if (s.mode === "live") q.set("live", "1");
  else {
    q.set("view", `${toAbsolute(s.view[0])}~${toAbsolute(s.view[1])}`);
    q.set("at", toAbsolute(s.cursor));
    if (!s.follow) q.set("held", "1");
    if (s.sel[0] != null || s.sel[1] != null) {
      q.set("sel", s.sel.map((t) => (t == null ? "" : toAbsolute(t))).join("~"));
    }
  }
  return q.toString();
}

// Encodes what another session can keep: its times are relative to the start of the data. A view of all data is left
// out, so that the other session shows all of its data.
/**
 * @param {any} s
 * @param {{layout?: string, edit?: string, snap?: string | null, annotate?: string, source?: string}} facts
 */
export function encodeSession(s, { layout, edit, snap, annotate, source }) {
  const q = new URLSearchParams();
  if (layout) q.set("layout", layout);
  if (edit) q.set("edit", edit);
  if (snap) q.set("snap", snap);
  if (annotate) {
    q.set("annotate", annotate);
    q.set("previous", source ?? "");
  }
  const whole = s.view[0] === s.data[0] && s.view[1] === s.data[1];
  const times = whole ? [s.cursor] : [s.cursor, ...s.view];
  q.set("since", times.map((t) => String(Math.round(t - s.data[0]))).join("~"));
  return q.toString();
}

// Decodes an address. Invalid parts are ignored, so that a damaged link still opens the store.
export function decodeLink(search, origin) {
  const q = new URLSearchParams(search);
  const parseNs = (x) => (/^-?\d{1,20}$/.test(x ?? "") ? Number(BigInt(x) - origin) : null);
  const parsePair = (name) => (q.get(name) ?? "").split("~").map(parseNs);
  const out = { live: q.get("live") === "1", snap: q.get("snap") || null, held: q.get("held") === "1" };
  const [a, b] = parsePair("view");
  if (a != null && b != null && a < b) out.view = [a, b];
  const since = (q.get("since") ?? "").split("~").map((x) => (/^-?\d{1,18}$/.test(x) ? Number(x) : null));
  if (since[0] != null) out.cursor = since[0];
  if (since[1] != null && since[2] != null && since[1] < since[2]) out.view = [since[1], since[2]];
  const at = parseNs(q.get("at"));
  if (at != null) out.cursor = at;
  const sel = parsePair("sel");
  if (sel.length === 2 && (sel[0] != null || sel[1] != null)) out.sel = sel;
  return out;
}
