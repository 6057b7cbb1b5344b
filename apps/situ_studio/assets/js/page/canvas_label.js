// Describes the contents of a canvas for users of screen readers: its streams and its time range. The values at the
// cursor are in the legends and tips, which are text.

import { formatRelative } from "../time/text.js";

const KINDS = {
  plot: "Plot",
  lanes: "Lanes",
  image: "Image",
  bars: "Bars",
  xy: "XY plot",
  space: "3D view",
  map: "Map",
};

// Returns the description of a panel. Pure.
export function describePanel(kind, names, { view, cursor }, timeline) {
  const when = timeline
    ? `from ${formatRelative(view[0])} to ${formatRelative(view[1])}`
    : `at ${formatRelative(cursor)}`;
  return `${KINDS[kind] ?? "Panel"} of ${names.join(", ") || "nothing"} ${when}`;
}

const SETTLED = 400;
const waiting = new WeakMap();

// Sets the label after nothing has moved for a moment, so that a screen reader is not interrupted for every frame.
export function scheduleLabel(view, state) {
  clearTimeout(waiting.get(view));
  waiting.set(
    view,
    setTimeout(() => {
      const { kind } = view.el?.dataset ?? {};
      if (!kind) return;
      const names = (view.config?.vis ?? [view.vis]).filter(Boolean).map((v) => v.name ?? v.stream);
      for (const canvas of view.el.querySelectorAll("canvas")) {
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", describePanel(kind, names, state(), view.timeline));
      }
    }, SETTLED),
  );
}
