// Lanes of segments: states, texts and time intervals.

import { laneNames, segmentAt, segmentText } from "../data/lanes.js";
import { GUTTER, FONT, themeColors, readableColor, stateColor } from "../page/theme.js";
import { formatDuration } from "../time/text.js";

const segments = {
  panel: "lanes",

  laneNames: (channel) => laneNames(channel.segments),

  describeAt({ channel, name }, t, slack, show) {
    const found = segmentAt(channel.segments?.get(name) ?? [], t, slack);
    return found ? segmentText(found, show) : [];
  },

  draw(ctx, { channel, name, index }, { view, x, y, h, end }) {
    const lane = name === "" ? null : index;
    ctx.font = FONT;
    ctx.textBaseline = "middle";
    let lastPx = -1;
    for (const row of channel.segments?.get(name) ?? []) {
      const [a, b, , cls] = row;
      const stop = Math.min(b, Math.max(end, a));
      if (stop < view[0] || a > view[1]) continue;
      const left = Math.max(x(a), GUTTER.left - 4);
      const width = Math.max(Math.min(x(stop), GUTTER.left + 1e5) - left, 1.5);
      if (width < 2 && Math.floor(left) === lastPx) continue;
      lastPx = Math.floor(left);
      if (cls === "many") drawHatched(ctx, row, left, width, y, h);
      else drawSegment(ctx, row, left, width, y, h, stateColor(row[2], cls, lane));
    }
    ctx.textBaseline = "alphabetic";
  },
};

function drawSegment(ctx, [a, b, label, cls], left, width, y, h, color) {
  ctx.fillStyle = color;
  if (cls === "false") {
    ctx.globalAlpha = 0.9;
    ctx.fillRect(left, y + h / 2 - 1, width, 2);
    ctx.globalAlpha = 1;
    return;
  }
  const soft = cls === "text" || cls === "span";
  ctx.globalAlpha = soft ? 0.26 : 0.85;
  roundedPath(ctx, left, y, width - (width > 4 ? 1 : 0), h, Math.min(3, width / 3));
  ctx.fill();
  ctx.globalAlpha = 1;
  // in dense lanes, the start marks must not cover the segments
  if (soft) ctx.fillRect(left, y, Math.min(2, Math.max(width / 4, 0.4)), h);
  if (cls === "true" || width <= 18 || h < 10) return;
  drawLabel(
    ctx,
    label === "" && cls === "span" ? formatDuration(b - a) : label,
    left,
    y,
    width,
    h,
    soft ? themeColors().text : readableColor(color),
  );
}

// Draws changes that cannot be distinguished, or messages that were not read: hatched, in a neutral color, with
// their number.
function drawHatched(ctx, [, , label], left, width, y, h) {
  const c = themeColors();
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, y, width, h);
  ctx.clip();
  ctx.strokeStyle = c.dim;
  ctx.globalAlpha = 0.55;
  ctx.beginPath();
  for (let px = left - h - ((left - h) % 6); px < left + width; px += 6) {
    ctx.moveTo(px, y + h);
    ctx.lineTo(px + h, y);
  }
  ctx.stroke();
  ctx.globalAlpha = 1;
  const room = ctx.measureText(label).width + 12;
  if (width > room + 8 && h >= 10) {
    const from = Math.max(left, GUTTER.left) + 4;
    ctx.fillStyle = c.panel;
    ctx.fillRect(from, y, room, h);
    ctx.fillStyle = c.dim;
    ctx.fillText(label, from + 6, y + h / 2 + 0.5);
  }
  ctx.restore();
}

function drawLabel(ctx, label, left, y, width, h, color) {
  const from = Math.max(left, GUTTER.left) + 6;
  const room = left + width - from - 4;
  if (room < 10) return;
  let text = label;
  if (ctx.measureText(text).width > room) {
    const n = Math.max(1, Math.floor((text.length * room) / ctx.measureText(text).width) - 1);
    text = text.slice(0, n).replace(/[\s.,:;]+$/, "") + "…";
  }
  ctx.fillStyle = color;
  ctx.fillText(text, from, y + h / 2 + 0.5);
}

function roundedPath(ctx, x, y, w, h, r) {
  ctx.beginPath();
  if (ctx.roundRect) ctx.roundRect(x, y, w, h, r);
  else ctx.rect(x, y, w, h);
}

export const states = { ...segments, id: "states" };
export const labels = { ...segments, id: "labels" };
export const spans = { ...segments, id: "spans" };
