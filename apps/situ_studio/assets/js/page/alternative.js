// The contents of a canvas in words, for users who do not see it: which streams, from when to when. The values at the
// cursor stand in the legends and tips, which are text.

import { relative } from "../time/text.js";

const KINDS = {
  plot: "Plot",
  lanes: "Lanes",
  image: "Picture",
  bars: "Bars",
  xy: "XY plot",
  space: "Things in space",
  map: "Map",
};

// Pure: the sentence of a panel.
export function sentence(kind, names, { view, cursor }, timeline) {
  const when = timeline ? `from ${relative(view[0])} to ${relative(view[1])}` : `at ${relative(cursor)}`;
  return `${KINDS[kind] ?? "Panel"} of ${names.join(", ") || "nothing"} ${when}`;
}

const SETTLED = 400;
const waiting = new WeakMap();

// Tells it when nothing has moved for a moment: who listens is not told each picture.
export function describe(view, state) {
  clearTimeout(waiting.get(view));
  waiting.set(
    view,
    setTimeout(() => {
      const { kind } = view.el?.dataset ?? {};
      if (!kind) return;
      const names = (view.config?.vis ?? [view.vis]).filter(Boolean).map((v) => v.name ?? v.stream);
      for (const canvas of view.el.querySelectorAll("canvas")) {
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", sentence(kind, names, state(), view.timeline));
      }
    }, SETTLED),
  );
}
