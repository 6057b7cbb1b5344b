// Determines which window of a stream to request, given the held one. Pure.
//
// Bins are powers of two nanoseconds wide and aligned globally, so that panning reuses them. A window extends half a
// view beyond both edges. While it is being fetched, the held data are drawn at the new scale.

export function binWidth(viewNs, px) {
  return 2 ** Math.max(0, Math.floor(Math.log2(Math.max(viewNs, 1) / Math.max(px, 1))));
}

// held: null or {from, to, bin, head, newest}. `head` was the end of all data at that time. `newest` is the time of
// the newest message of this stream, which may lag behind; growing data are requested from there. Returns null
// (enough is held) or {from, to, bin, append}.
export function planWindow(held, view, px, data, live) {
  const [v0, v1] = view;
  const w = v1 - v0;
  const bin = binWidth(w, px);
  const head = data[1];
  if (held && held.bin === bin) {
    const left = v0 >= held.from || held.from <= data[0];
    const right = v1 <= held.to || held.to >= head;
    const grown = head > held.head && held.to >= held.head && v1 > held.head;
    if (left && right && !grown) return null;
    if (left && grown && held.to >= held.head) {
      const known = Math.min(held.head, held.newest ?? held.head);
      const from = Math.max(Math.floor(known / bin - 1) * bin, held.from);
      if (head - from < 4 * w) return { from, to: alignUp(v1 + w / 2, bin), bin, append: true };
    }
  }
  const margin = live ? 0 : w / 2;
  return {
    from: Math.floor((v0 - margin) / bin) * bin,
    to: alignUp(v1 + margin, bin),
    bin,
    append: false,
  };
}

const alignUp = (t, bin) => Math.ceil(t / bin) * bin;
