// Draws an annotation on its row: a bar, or a dot for a point in time. Proposals are transparent with a dashed edge.

import { GUTTER, themeColors, readableColor, stateColor } from "../page/theme.js";

export const ROW = 26;

function annotationColor(a, attribute) {
  const value = a.values[attribute?.name];
  const own = attribute?.values.find((v) => v.value === value)?.fill ?? attribute?.fill;
  return own ?? stateColor(String(value ?? ""), value === true ? "true" : "state");
}

// Draws one annotation. `timeToX` maps a time to pixels; the options name the shown attribute, the selected
// annotation, and the confidence from which proposals would be accepted.
export function drawAnnotation(ctx, a, x, y, { state, attribute: nth, selected, least = 0 }) {
  const attribute = state.attributes[nth];
  const c = themeColors(),
    color = annotationColor(a, attribute);
  const left = x(a.from),
    right = x(a.to),
    width = Math.max(right - left, 2);
  ctx.fillStyle = ctx.strokeStyle = color;
  if (a.to === a.from) {
    ctx.beginPath();
    ctx.arc(left, y + ROW / 2, 4, 0, 2 * Math.PI);
    ctx.fill();
  } else {
    const doubtful = a.proposed && (a.confidence ?? 1) < least;
    ctx.globalAlpha = doubtful ? 0.05 : a.proposed ? 0.22 : a.pending ? 0.5 : 0.85;
    ctx.fillRect(left, y + 3, width, ROW - 6);
    ctx.globalAlpha = 1;
    if (a.proposed) {
      ctx.setLineDash([4, 3]);
      ctx.strokeRect(left + 0.5, y + 3.5, width - 1, ROW - 7);
      ctx.setLineDash([]);
    }
    const text = String(a.values[attribute?.name] ?? "");
    if (width > 24) {
      ctx.fillStyle = a.proposed ? c.text : readableColor(color);
      ctx.save();
      ctx.beginPath();
      ctx.rect(left, y, width - 3, ROW);
      ctx.clip();
      ctx.fillText(text, Math.max(left, GUTTER.left) + 6, y + ROW / 2);
      ctx.restore();
    }
  }
  if (a.id !== undefined && a.id === selected) {
    ctx.strokeStyle = c.text;
    ctx.lineWidth = 1.5;
    ctx.strokeRect(left, y + 2, width, ROW - 4);
    ctx.lineWidth = 1;
  }
}

// Draws the lines of the time axis.
export function drawGrid(ctx, positions, top, height) {
  ctx.fillStyle = themeColors().grid;
  for (const x of positions) ctx.fillRect(Math.round(x), top, 1, height);
}
