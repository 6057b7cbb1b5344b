// Masks over an image: the pixels of each class, or of each object in its box, transparent, each in its color.

import { KIND } from "../data/frames.js";
import { FONT, seriesColor } from "../page/theme.js";
import { formatNumber } from "../page/number_text.js";
import { drawTag } from "./shapes.js";
import { getContext2d } from "../page/dom.js";
import { parseRgb } from "./depth_colors.js";

const OPACITY = 45;

export const masks = {
  id: "masks",
  panel: "image",

  acceptFrame(layer, frame, changed) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    const value = frame.kind === KIND.json ? frame.value : null;
    layer.masks =
      value && (value.classes ? { classes: unpackRuns(value.classes) } : { found: value.masks.map(unpackObject) });
    layer.drawnFor = null;
    changed();
  },

  restyle() {},
  close() {},

  draw(ctx, layer, { map, fit }) {
    const { masks: shown, vis } = layer;
    if (!shown) return;
    const props = vis.props ?? {};
    colorMasks(layer);
    ctx.save();
    ctx.globalAlpha = (props.opacity ?? OPACITY) / 100;
    ctx.imageSmoothingEnabled = false;
    const drawMask = (canvas, [x, y, w, h]) => {
      const left = map.x(x),
        width = map.x(x + w) - left;
      ctx.save();
      ctx.translate(left, map.y(y));
      // masks of a mirrored image are mirrored, too
      if (width < 0) ctx.scale(-1, 1);
      ctx.drawImage(canvas, 0, 0, Math.abs(width), h * map.k);
      ctx.restore();
    };
    if (shown.classes) drawMask(shown.classes.canvas, coveredRect(shown.classes, fit, props.fit));
    for (const m of shown.found ?? []) drawMask(m.canvas, m.box);
    ctx.restore();
    if (props.labels === false) return;
    ctx.font = FONT;
    (shown.found ?? []).forEach((m, i) => {
      const [x, y, w] = m.box;
      const text = [m.label, m.id, m.score == null ? null : formatNumber(m.score, 2)]
        .filter((p) => p != null)
        .join("  ");
      if (text) drawTag(ctx, text, Math.min(map.x(x), map.x(x + w)), map.y(y), objectColor(layer, m, i));
    });
  },

  // Describes the class or the objects at a position of the image.
  describeAt(layer, x, y) {
    const { masks: shown, size } = layer;
    if (!shown) return [];
    if (shown.classes) {
      const value = valueAt(shown.classes, coveredRect(shown.classes, size, layer.vis.props?.fit), x, y);
      return value ? [`class ${value}`] : [];
    }
    return shown.found.flatMap((m) => {
      if (!valueAt(m, m.box, x, y)) return [];
      return [m.label || "object", ...(m.score == null ? [] : [`score ${formatNumber(m.score, 4)}`])].concat(
        m.id == null ? [] : [`id ${m.id}`],
      );
    });
  },
};

const unpackObject = (m) => ({ ...unpackRuns(m), box: m.box, label: m.label, score: m.score, id: m.id });

// Decodes runs of [value, count] pairs.
export function unpackRuns({ width, height, runs }) {
  const values = new Uint8Array(width * height);
  let at = 0;
  for (let i = 0; i + 1 < runs.length; i += 2) {
    values.fill(runs[i], at, at + runs[i + 1]);
    at += runs[i + 1];
  }
  return { width, height, values };
}

// Returns the part of the image that class numbers cover: [x, y, width, height].
/** @returns {[x: number, y: number, width: number, height: number]} */
export function coveredRect({ width, height }, picture, fit) {
  const { width: w, height: h } = picture;
  if (fit === "whole" || width !== height) return [0, 0, w, h];
  const side = fit === "crop" ? Math.min(w, h) : Math.max(w, h);
  return [(w - side) / 2, (h - side) / 2, side, side];
}

function valueAt({ width, height, values }, [x, y, w, h], px, py) {
  const i = Math.floor(((px - x) / w) * width),
    j = Math.floor(((py - y) / h) * height);
  return i >= 0 && j >= 0 && i < width && j < height ? values[j * width + i] : 0;
}

const objectColor = ({ vis, index }, m, i) =>
  seriesColor(null, Number.isInteger(m.id) ? m.id : (vis.color ?? index) + i);

// Draws each mask onto a canvas, once for a message and a theme.
function colorMasks(layer) {
  const theme = seriesColor(null, 0);
  if (layer.drawnFor === theme) return;
  layer.drawnFor = theme;
  const { classes, found } = layer.masks;
  if (classes) classes.canvas = paintMask(classes, (v) => shadeColor(parseColor(seriesColor(null, v - 1)), v - 1));
  (found ?? []).forEach((m, i) => (m.canvas = paintMask(m, () => parseColor(objectColor(layer, m, i)))));
}

/** @typedef {[red: number, green: number, blue: number, alpha: number]} Rgba */

// There are eight colors and more classes: each further round is darker or lighter, so that 32 classes differ.
const SHADES = [1, 0.6, 0.8, 0.4];

/** @param {Rgba} color @param {number} index @returns {Rgba} */
export function shadeColor([r, g, b, a], index) {
  const k = SHADES[Math.floor(index / 8) % SHADES.length];
  return [Math.round(r * k), Math.round(g * k), Math.round(b * k), a];
}

function paintMask({ width, height, values }, colorOfValue) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [Math.max(width, 1), Math.max(height, 1)];
  const ctx = getContext2d(canvas);
  const image = ctx.createImageData(canvas.width, canvas.height);
  const known = new Map();
  for (let i = 0; i < values.length; i++) {
    const v = values[i];
    if (!v) continue;
    if (!known.has(v)) known.set(v, colorOfValue(v));
    image.data.set(known.get(v), 4 * i);
  }
  ctx.putImageData(image, 0, 0);
  return canvas;
}

/** @param {string} hex @returns {Rgba} */
const parseColor = (hex) => [...parseRgb(hex), 255];
