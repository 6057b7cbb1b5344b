// Lists the rows of the annotation panel: the visible tracks, with one row for each attribute.

import { truncateText } from "../page/gutter.js";
import { GUTTER, themeColors } from "../page/theme.js";
import { ROW } from "./draw.js";
import { findTier } from "./tiers.js";

/**
 * @typedef {{id: string, track: string, from: number, to: number, values: object}} Annotation
 * @typedef {{attributes: object[], tracks: string[],
 *   tiers: import("./tiers.js").Tier[], items: Annotation[], undo: number, redo: number,
 *   version?: number}} AnnotationState
 */

// Returns the lowest number that is not in a list of names, as text.
export function freeNumber(names) {
  let n = 1;
  while (names.includes(String(n))) n++;
  return String(n);
}

// The choices of which tracks are shown.
export const SHOWN = [
  ["all", "All tracks"],
  ["view", "Tracks with annotations in view"],
  ["one", "Selected track only"],
];

// Returns [{track, attribute: its index, first: whether it is the first row of its track}]. Boxes and points need
// only one row.
export function listRows({ state, track, attribute, shown, spatial, tracks }, view) {
  const isInView = (name) => state.items.some((a) => a.track === name && a.to >= view[0] && a.from <= view[1]);
  const visible = tracks.filter((name) => name === track || shown === "all" || (shown === "view" && isInView(name)));
  const several = !spatial && state.attributes.length > 1;
  const all = several ? state.attributes.map((_, i) => i) : [attribute];
  // a tier has one attribute
  const indices = (name) => {
    const own = findTier(state.tiers, name)?.attribute;
    return own ? [state.attributes.findIndex((a) => a.name === own)] : all;
  };
  return visible.flatMap((name) => indices(name).map((i, nth) => ({ track: name, attribute: i, first: nth === 0 })));
}

// Returns the label of a row: its track, and its attribute if there are several.
export function rowLabel({ track, attribute, first }, attributes, several) {
  if (!several) return track;
  const { name } = attributes[attribute];
  return first ? `${track}  ${name}` : name;
}

export function drawName(ctx, text, y, { chosen, first }) {
  const c = themeColors();
  if (chosen) {
    ctx.fillStyle = c.accent;
    ctx.fillRect(0, y + 3, 3, ROW - 6);
  }
  ctx.textAlign = "right";
  ctx.fillStyle = chosen && first ? c.text : c.axis;
  ctx.fillText(truncateText(ctx, text, GUTTER.left - 14), GUTTER.left - 6, y + ROW / 2);
  ctx.textAlign = "left";
}
