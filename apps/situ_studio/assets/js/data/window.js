// Which window of a stream to ask for, given what is held. Pure.
//
// Bins are powers of two nanoseconds wide and aligned globally, so that panning reuses them. A window reaches half a
// view beyond both edges; while it is on its way, what is held is drawn at the new scale.

export function binWidth(viewNs, px) {
  return 2 ** Math.max(0, Math.floor(Math.log2(Math.max(viewNs, 1) / Math.max(px, 1))));
}

// held: null or {from, to, bin, head, newest}: `head` was the end of all data then, `newest` the time of the newest
// message of this very stream, which may lag behind: what grows is asked for from there. Answers null (enough is
// held) or {from, to, bin, append}.
export function want(held, view, px, data, live) {
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
      if (head - from < 4 * w) return { from, to: align(v1 + w / 2, bin), bin, append: true };
    }
  }
  const margin = live ? 0 : w / 2;
  return {
    from: Math.floor((v0 - margin) / bin) * bin,
    to: align(v1 + margin, bin),
    bin,
    append: false,
  };
}

const align = (t, bin) => Math.ceil(t / bin) * bin;
