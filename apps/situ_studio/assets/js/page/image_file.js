// Saves a panel as a file: its canvases and background as PNG, or its drawing as SVG, both with the panel's names.

import { FONT, themeColors } from "./theme.js";
import { showToast } from "./toast.js";
import { SvgContext } from "./svg_context.js";
import { getContext2d } from "./dom.js";

export function saveImage(_app, body) {
  const scale = devicePixelRatio,
    box = body.getBoundingClientRect();
  const out = document.createElement("canvas");
  [out.width, out.height] = [Math.round(box.width * scale), Math.round(box.height * scale)];
  const ctx = getContext2d(out);
  ctx.scale(scale, scale);
  ctx.fillStyle = themeColors().panel;
  ctx.fillRect(0, 0, box.width, box.height);
  for (const canvas of body.querySelectorAll("canvas")) {
    const r = canvas.getBoundingClientRect();
    if (r.width && r.height) ctx.drawImage(canvas, r.left - box.left, r.top - box.top, r.width, r.height);
  }
  drawNames(ctx, body, box);
  out.toBlob((blob) => saveFile(blob, body, "png"), "image/png");
}

const findView = (app, body) => [...app.views].find((v) => v.el === body);

// Returns true if a panel draws only lines and texts, not with WebGL.
export function canDrawVector(app, body) {
  return !!findView(app, body) && DRAWN.includes(body.dataset.kind);
}

const DRAWN = ["plot", "lanes", "image", "bars", "xy"];

export function saveVector(app, body) {
  const box = body.getBoundingClientRect();
  const view = findView(app, body);
  const ctx = new SvgContext(box.width, box.height, getContext2d(document.createElement("canvas")));
  if (view.drawVector) view.drawVector(ctx);
  else view.render(ctx);
  ctx.globalAlpha = 1;
  ctx.textAlign = "left";
  drawNames(ctx, body, box);
  const title = JSON.parse(body.dataset.config).vis.map((v) => v.name);
  saveFile(new Blob([ctx.toSvg(themeColors().panel, title.join(", "))], { type: "image/svg+xml" }), body, "svg");
}

// Draws the page elements over the drawing: names, values, information.
function drawNames(ctx, body, box) {
  ctx.font = FONT;
  ctx.textBaseline = "middle";
  for (const el of body.querySelectorAll(".legend-item, .lane-name, .cell-info")) {
    const r = el.getBoundingClientRect();
    ctx.fillStyle = getComputedStyle(el).color;
    if (el.textContent) ctx.fillText(el.textContent, r.left - box.left + 4, r.top - box.top + r.height / 2, r.width);
  }
}

function saveFile(blob, body, ending) {
  const a = document.createElement("a");
  const vis = JSON.parse(body.dataset.config).vis[0];
  a.href = URL.createObjectURL(blob);
  a.download = `${(vis?.name ?? "panel").replace(/[^\w.-]+/g, "_")}.${ending}`;
  a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 10000);
  showToast(`Saved as ${a.download}`);
}
