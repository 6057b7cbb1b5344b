// The address holds what is looked at: layout, view, cursor, selection; times are absolute nanoseconds, so that a
// copied link gives the same picture anywhere.

export function encode(s, origin, { layout, edit, snap, annotate, compare } = {}) {
  const abs = (t) => (origin + BigInt(Math.round(t))).toString();
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
    q.set("view", `${abs(s.view[0])}~${abs(s.view[1])}`);
    q.set("at", abs(s.cursor));
    if (!s.follow) q.set("held", "1");
    if (s.sel[0] != null || s.sel[1] != null) {
      q.set("sel", s.sel.map((t) => (t == null ? "" : abs(t))).join("~"));
    }
  }
  return q.toString();
}

// Unreadable parts are left out: a damaged link opens the store all the same.
export function decode(search, origin) {
  const q = new URLSearchParams(search);
  const time = (x) => (/^-?\d{1,20}$/.test(x ?? "") ? Number(BigInt(x) - origin) : null);
  const pair = (name) => (q.get(name) ?? "").split("~").map(time);
  const out = { live: q.get("live") === "1", snap: q.get("snap") || null, held: q.get("held") === "1" };
  const [a, b] = pair("view");
  if (a != null && b != null && a < b) out.view = [a, b];
  const at = time(q.get("at"));
  if (at != null) out.cursor = at;
  const sel = pair("sel");
  if (sel.length === 2 && (sel[0] != null || sel[1] != null)) out.sel = sel;
  return out;
}
