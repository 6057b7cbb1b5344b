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

// Decodes an address. Invalid parts are ignored, so that a damaged link still opens the store.
export function decodeLink(search, origin) {
  const q = new URLSearchParams(search);
  const parseNs = (x) => (/^-?\d{1,20}$/.test(x ?? "") ? Number(BigInt(x) - origin) : null);
  const parsePair = (name) => (q.get(name) ?? "").split("~").map(parseNs);
  const out = { live: q.get("live") === "1", snap: q.get("snap") || null, held: q.get("held") === "1" };
  const [a, b] = parsePair("view");
  if (a != null && b != null && a < b) out.view = [a, b];
  const at = parseNs(q.get("at"));
  if (at != null) out.cursor = at;
  const sel = parsePair("sel");
  if (sel.length === 2 && (sel[0] != null || sel[1] != null)) out.sel = sel;
  return out;
}
