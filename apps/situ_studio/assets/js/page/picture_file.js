// A panel as a file: as PNG its canvases over its background, as SVG what they draw; both with the panel's names.

import { FONT, theme } from "./theme.js";
import { toast } from "./toast.js";
import { Vector } from "./vector.js";

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
  names(ctx, body, box);
  out.toBlob((blob) => save(blob, body, "png"), "image/png");
}

const viewOf = (app, body) => [...app.views].find((v) => v.el === body);

// Whether a panel can be drawn as lines and texts: not what a graphics card draws.
export function drawable(app, body) {
  return !!viewOf(app, body) && DRAWN.includes(body.dataset.kind);
}

const DRAWN = ["plot", "lanes", "image", "bars", "xy"];

export function saveVector(app, body) {
  const box = body.getBoundingClientRect();
  const view = viewOf(app, body);
  const ctx = new Vector(box.width, box.height, document.createElement("canvas").getContext("2d"));
  if (view.vector) view.vector(ctx);
  else view.render(ctx);
  ctx.globalAlpha = 1;
  ctx.textAlign = "left";
  names(ctx, body, box);
  const title = JSON.parse(body.dataset.config).vis.map((v) => v.name);
  save(new Blob([ctx.text(theme().panel, title.join(", "))], { type: "image/svg+xml" }), body, "svg");
}

// The elements of the page over the drawing: names, values, facts.
function names(ctx, body, box) {
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  for (const el of body.querySelectorAll(".legend-item, .lane-name, .cell-info")) {
    const r = el.getBoundingClientRect();
    ctx.fillStyle = getComputedStyle(el).color;
    if (el.textContent) ctx.fillText(el.textContent, r.left - box.left + 4, r.top - box.top + r.height / 2, r.width);
  }
}

function save(blob, body, ending) {
  const a = document.createElement("a");
  const vis = JSON.parse(body.dataset.config).vis[0];
  a.href = URL.createObjectURL(blob);
  a.download = `${(vis?.name ?? "panel").replace(/[^\w.-]+/g, "_")}.${ending}`;
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 10000);
  toast(`Saved as ${a.download}`);
}
