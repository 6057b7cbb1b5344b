// The rows of the annotations: the tracks in sight, each with a row for each attribute.

import { fitted } from "../page/gutter.js";
import { GUTTER, theme } from "../page/theme.js";
import { ROW } from "./draw.js";

// Which tracks are shown.
export const SHOWN = [
  ["all", "All tracks"],
  ["view", "Tracks with annotations in view"],
  ["one", "The chosen track only"],
];

// [{track, attribute: its index, first: whether it is the track's first}]; places on pictures need one row.
export function rowsOf({ told, track, attribute, shown, spatial, tracks }, view) {
  const within = (name) => told.items.some((a) => a.track === name && a.to >= view[0] && a.from <= view[1]);
  const visible = tracks.filter((name) => name === track || shown === "all" || (shown === "view" && within(name)));
  const several = !spatial && told.attributes.length > 1;
  const indices = several ? told.attributes.map((_, i) => i) : [attribute];
  return visible.flatMap((name) => indices.map((i, nth) => ({ track: name, attribute: i, first: nth === 0 })));
}

// The text beside a row: its track, and its attribute where there are several.
export function nameOf({ track, attribute, first }, attributes, several) {
  if (!several) return track;
  const { name } = attributes[attribute];
  return first ? `${track}  ${name}` : name;
}

export function drawName(ctx, text, y, { chosen, first }) {
  const c = theme();
  if (chosen) {
    ctx.fillStyle = c.accent;
    ctx.fillRect(0, y + 3, 3, ROW - 6);
  }
  ctx.textAlign = "right";
  ctx.fillStyle = chosen && first ? c.text : c.axis;
  ctx.fillText(fitted(ctx, text, GUTTER.left - 14), GUTTER.left - 6, y + ROW / 2);
  ctx.textAlign = "left";
}
