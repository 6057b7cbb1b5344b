// Draws a map: tiles or a grid of degrees, tracks, current positions and a scale. All sizes are in pixels of the
// page.

import { gridStep, unitsPerMetre, roundScale, visibleTiles, toLatitude, toLongitude, toX, toY } from "./mercator.js";
import { countUntil } from "./track.js";
import { FONT } from "../page/theme.js";
import { formatNumber } from "../page/number_text.js";

// Converts a position (x, y) of the Mercator square to canvas pixels; `map` is {x, y, px}.
const toCanvas = (map, x, y) => [(x - map.x) * map.px, (y - map.y) * map.px];

export function drawGrid(ctx, map, width, height, theme) {
  const step = gridStep((90 / map.px) * 360);
  ctx.strokeStyle = theme.grid;
  ctx.fillStyle = theme.dim;
  ctx.lineWidth = 1;
  ctx.font = FONT;
  const digits = step < 1 ? Math.ceil(-Math.log10(step)) : 0;
  const west = toLongitude(map.x),
    east = toLongitude(map.x + width / map.px);
  for (let lon = Math.ceil(west / step) * step; lon <= east; lon += step) {
    const [px] = toCanvas(map, toX(lon), 0);
    drawLine(ctx, px, 0, px, height);
    const there = ((((lon + 180) % 360) + 360) % 360) - 180;
    ctx.fillText(`${Math.abs(there).toFixed(digits)}° ${there < 0 ? "W" : "E"}`, px + 3, height - 5);
  }
  const north = toLatitude(Math.max(map.y, 0)),
    south = toLatitude(Math.min(map.y + height / map.px, 1));
  for (let lat = Math.ceil(south / step) * step; lat <= north; lat += step) {
    const [, py] = toCanvas(map, 0, toY(lat));
    drawLine(ctx, 0, py, width, py);
    ctx.fillText(`${Math.abs(lat).toFixed(digits)}° ${lat < 0 ? "S" : "N"}`, 4, py - 3);
  }
}

function drawLine(ctx, a, b, c, d) {
  ctx.beginPath();
  ctx.moveTo(Math.round(a) + 0.5, Math.round(b) + 0.5);
  ctx.lineTo(Math.round(c) + 0.5, Math.round(d) + 0.5);
  ctx.stroke();
}

// Draws the tiles that are loaded; `fetch(tile)` returns an image, or null while it is loading.
export function drawTiles(ctx, map, width, height, fetch) {
  for (const tile of visibleTiles(map, width, height)) {
    const picture = fetch(tile);
    if (picture) ctx.drawImage(picture, tile.left, tile.top, tile.size + 0.5, tile.size + 0.5);
  }
}

// Draws a track: opaque up to the cursor, faint after it.
export function drawTrack(ctx, map, { track, color, width, points }, cursor) {
  const now = countUntil(track, cursor);
  ctx.strokeStyle = ctx.fillStyle = color;
  ctx.lineWidth = width;
  ctx.lineJoin = ctx.lineCap = "round";
  for (const [from, to, alpha] of [
    [Math.max(now - 1, 0), track.count, 0.35],
    [0, now, 1],
  ]) {
    ctx.globalAlpha = alpha;
    ctx.beginPath();
    for (let i = from; i < to; i++) ctx.lineTo(...toCanvas(map, track.x[i], track.y[i]));
    ctx.stroke();
    if (!points) continue;
    for (let i = from; i < to; i++) {
      const [x, y] = toCanvas(map, track.x[i], track.y[i]);
      ctx.fillRect(x - width, y - width, 2 * width, 2 * width);
    }
  }
  ctx.globalAlpha = 1;
}

export function drawPosition(ctx, map, { place, color, accuracy }, theme) {
  const [x, y] = toCanvas(map, place.x, place.y);
  if (accuracy && place.accuracy > 0) {
    const r = place.accuracy * unitsPerMetre(place.latitude) * map.px;
    ctx.fillStyle = color;
    ctx.globalAlpha = 0.18;
    ctx.beginPath();
    ctx.arc(x, y, Math.max(r, 1), 0, 7);
    ctx.fill();
    ctx.globalAlpha = 1;
    ctx.strokeStyle = color;
    ctx.lineWidth = 1;
    ctx.stroke();
  }
  ctx.fillStyle = color;
  ctx.strokeStyle = theme.bg;
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.arc(x, y, 6, 0, 7);
  ctx.fill();
  ctx.stroke();
}

export function drawScale(ctx, map, width, height, theme, credit) {
  const latitude = toLatitude(map.y + height / 2 / map.px);
  const { metres, px } = roundScale(120, 1 / (unitsPerMetre(latitude) * map.px));
  const text = metres >= 1000 ? `${formatNumber(metres / 1000, 1)} km` : `${formatNumber(metres, 3)} m`;
  const left = width - px - 14,
    y = height - 22;
  ctx.strokeStyle = ctx.fillStyle = theme.text;
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.moveTo(left, y - 4);
  ctx.lineTo(left, y);
  ctx.lineTo(left + px, y);
  ctx.lineTo(left + px, y - 4);
  ctx.stroke();
  ctx.font = FONT;
  ctx.textAlign = "right";
  ctx.fillText(text, left + px, y - 7);
  if (credit) ctx.fillText(credit, width - 6, 14);
  ctx.textAlign = "left";
}
