// Draws the scale of colors and distances in the lower right corner of a depth image.

import { FONT, themeColors } from "../page/theme.js";
import { COLORS, formatDistance } from "./depth_colors.js";

const BAR = { width: 96, height: 7, margin: 8 };

export function drawScale(ctx, w, h, { range, unit }) {
  const [near, far] = range.map((v) => formatDistance(v, unit));
  ctx.font = FONT;
  const room = BAR.width + 12;
  const text = ctx.measureText(near).width + ctx.measureText(far).width + 12;
  const wide = Math.max(room, text + 12);
  if (w < wide + 120 || h < 90) return;
  const left = w - wide - BAR.margin,
    top = h - 36;
  ctx.fillStyle = themeColors().bg;
  ctx.globalAlpha = 0.72;
  ctx.fillRect(left, top, wide, 30);
  ctx.globalAlpha = 1;
  const inner = wide - 12;
  const ramp = ctx.createLinearGradient(left + 6, 0, left + 6 + inner, 0);
  COLORS.forEach((c, i) => i % 15 === 0 && ramp.addColorStop(i / 255, `rgb(${c})`));
  ctx.fillStyle = ramp;
  ctx.fillRect(left + 6, top + 5, inner, BAR.height);
  ctx.fillStyle = themeColors().text;
  ctx.textBaseline = "alphabetic";
  ctx.fillText(near, left + 6, top + 25);
  ctx.textAlign = "right";
  ctx.fillText(far, left + 6 + inner, top + 25);
  ctx.textAlign = "left";
}
