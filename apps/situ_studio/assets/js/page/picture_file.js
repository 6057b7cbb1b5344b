// A panel as a PNG file: its canvases over its background, with its names.

import { FONT, theme } from "./theme.js";
import { toast } from "./toast.js";

export function savePicture(_app, body) {
  const scale = devicePixelRatio,
    box = body.getBoundingClientRect();
  const out = document.createElement("canvas");
  [out.width, out.height] = [Math.round(box.width * scale), Math.round(box.height * scale)];
  const ctx = out.getContext("2d");
  ctx.scale(scale, scale);
  ctx.fillStyle = theme().panel;
  ctx.fillRect(0, 0, box.width, box.height);
  for (const canvas of body.querySelectorAll("canvas")) {
    const r = canvas.getBoundingClientRect();
    if (r.width && r.height) ctx.drawImage(canvas, r.left - box.left, r.top - box.top, r.width, r.height);
  }
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  for (const el of body.querySelectorAll(".legend-item, .lane-name, .cell-info")) {
    const r = el.getBoundingClientRect();
    ctx.fillStyle = getComputedStyle(el).color;
    if (el.textContent) ctx.fillText(el.textContent, r.left - box.left + 4, r.top - box.top + r.height / 2, r.width);
  }
  out.toBlob((blob) => {
    const a = document.createElement("a");
    const vis = JSON.parse(body.dataset.config).vis[0];
    a.href = URL.createObjectURL(blob);
    a.download = `${(vis?.name ?? "panel").replace(/[^\w.-]+/g, "_")}.png`;
    a.click();
    setTimeout(() => URL.revokeObjectURL(a.href), 10000);
    toast(`Saved as ${a.download}`);
  }, "image/png");
}
