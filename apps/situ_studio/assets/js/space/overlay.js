// Draws texts and lines over the 3D view: labels of the layers, color scales, the measured distance.

import { Vector3 } from "three";
import { RAMP_COLORS } from "./colors.js";
import { FONT, readableColor } from "../page/theme.js";
import { formatNumber } from "../page/number_text.js";

const MOST = 500;

// Returns the position of a point on the canvas (in pixels of the page), or null if it is behind the viewer.
export function projectPoint(point, camera, width, height) {
  const v = point.clone().project(camera);
  if (!(v.z > -1 && v.z < 1)) return null;
  return [((v.x + 1) / 2) * width, ((1 - v.y) / 2) * height];
}

export function drawTexts(ctx, layers, camera, width, height) {
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  let left = MOST;
  for (const layer of layers) {
    if (!layer.group.visible || layer.props?.labels === false) continue;
    for (const item of layer.texts) {
      for (let i = 0; i < item.count && left > 0; i++) {
        const point = new Vector3().fromArray(item.position, 3 * i).applyMatrix4(layer.group.matrix);
        const at = projectPoint(point, camera, width, height);
        if (!at) continue;
        left--;
        drawLabel(ctx, item.names[i], at[0], at[1] - 14, layer.props.color);
      }
    }
  }
}

function drawLabel(ctx, text, x, y, color) {
  const w = ctx.measureText(text).width + 10;
  ctx.fillStyle = color;
  ctx.fillRect(x - w / 2, y - 8, w, 16);
  ctx.fillStyle = readableColor(color);
  ctx.fillText(text, x - w / 2 + 5, y + 0.5);
}

// Draws a color scale for each layer that is colored by value, in the upper right corner.
export function drawScales(ctx, layers, width, theme) {
  let top = 10;
  ctx.font = FONT;
  for (const layer of layers) {
    const scale = layer.parts.find((p) => p.scale)?.scale;
    if (!scale || layer.near || !layer.group.visible || layer.props.scale === false) continue;
    const w = 132,
      left = width - w - 10;
    ctx.globalAlpha = 0.8;
    ctx.fillStyle = theme.bg;
    ctx.fillRect(left, top, w, 40);
    ctx.globalAlpha = 1;
    const colors = ctx.createLinearGradient(left + 6, 0, left + w - 6, 0);
    RAMP_COLORS.forEach((c, i) => i % 15 === 0 && colors.addColorStop(i / 255, `rgb(${c})`));
    ctx.fillStyle = colors;
    ctx.fillRect(left + 6, top + 18, w - 12, 6);
    ctx.fillStyle = theme.text;
    ctx.textBaseline = "alphabetic";
    ctx.fillText(truncateText(ctx, `${layer.short}: ${scale.mode}`, w - 12), left + 6, top + 13);
    ctx.fillText(formatNumber(scale.span[0], 2), left + 6, top + 36);
    ctx.textAlign = "right";
    ctx.fillText(formatNumber(scale.span[1], 2), left + w - 6, top + 36);
    ctx.textAlign = "left";
    top += 46;
  }
}

function truncateText(ctx, text, width) {
  let t = text;
  while (t.length > 4 && ctx.measureText(t).width > width) t = `${t.slice(0, -2)}…`;
  return t;
}

export function drawMeasure(ctx, points, camera, width, height, theme) {
  const seen = points.map((p) => projectPoint(p, camera, width, height)).filter(Boolean);
  ctx.strokeStyle = ctx.fillStyle = theme.accent;
  ctx.lineWidth = 2;
  for (const [x, y] of seen) {
    ctx.beginPath();
    ctx.arc(x, y, 4, 0, 7);
    ctx.stroke();
  }
  if (seen.length < 2) return;
  ctx.beginPath();
  ctx.moveTo(...seen[0]);
  ctx.lineTo(...seen[1]);
  ctx.stroke();
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  const text = `${formatNumber(points[0].distanceTo(points[1]), 3)} m`;
  drawLabel(ctx, text, (seen[0][0] + seen[1][0]) / 2, (seen[0][1] + seen[1][1]) / 2 - 12, theme.accent);
}
