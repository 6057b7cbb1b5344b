// Paints the rows of the annotation panel: their names, the grid, the annotations, and unfinished annotations.

import { GUTTER, FONT } from "../page/theme.js";
import { rulerTicks } from "../time/clock.js";
import { ROW, drawAnnotation, drawGrid } from "./draw.js";
import { drawName } from "./rows.js";

/** @param {import("./panel.js").AnnotationPanel} panel */
export function paintRows(panel) {
  const ctx = panel.canvas.getContext("2d");
  const w = panel.el.clientWidth,
    h = panel.el.clientHeight;
  const { view, cursor } = panel.app.time.get();
  const { toolsHeight: head } = panel;
  const inner = w - GUTTER.left - GUTTER.right;
  const timeToX = (t) => GUTTER.left + ((t - view[0]) * inner) / (view[1] - view[0]);
  ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  ctx.clearRect(0, 0, w, h);
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  const rows = panel.visibleRows();
  if (panel.shownTracks === "view") panel.fitHeight();
  rows.forEach((r, i) =>
    drawName(ctx, panel.rowName(r), head + i * ROW, { chosen: r.track === panel.track && !r.layer, first: r.first }),
  );
  ctx.save();
  ctx.beginPath();
  ctx.rect(GUTTER.left, head - 2, inner, h);
  ctx.clip();
  drawGrid(ctx, rulerTicks(view, inner, panel.app.client.origin).at.map(timeToX), head, h);
  rows.forEach((row, i) => {
    const { track, attribute } = row;
    if (row.layer) return panel.merged.drawRow(ctx, row, timeToX, head + i * ROW);
    const look = { state: panel.state, attribute, selected: panel.selected, least: panel.tools.minConfidence };
    for (const a of panel.state.items)
      if (a.track === track) drawAnnotation(ctx, withDrag(panel, a), timeToX, head + i * ROW, look);
    if (track !== panel.track) return;
    const pending = [...panel.keys.pendingAnnotations(cursor), ...panel.segmentation.pendingAnnotations(cursor)];
    for (const p of pending) drawAnnotation(ctx, { ...p, track, pending: true }, timeToX, head + i * ROW, look);
  });
  ctx.restore();
}

// Shows the edge that the mouse moves at its new time.
function withDrag({ drag }, a) {
  return drag && drag.id === a.id ? { ...a, [drag.edge]: drag.t } : a;
}
