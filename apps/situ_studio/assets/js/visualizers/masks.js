// Masks over a picture: the places of each class, or of each object in its box; see-through, each in its colour.

import { KIND } from "../data/wire.js";
import { FONT, seriesColor } from "../page/theme.js";
import { number } from "../page/number_text.js";
import { tag } from "./shapes.js";

const OPACITY = 45;

export const masks = {
  id: "masks",
  panel: "image",

  accept(layer, frame, changed) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    const value = frame.kind === KIND.json ? frame.value : null;
    layer.masks = value && (value.classes ? { classes: unpack(value.classes) } : { found: value.masks.map(object) });
    layer.drawnFor = null;
    changed();
  },

  restyle() {},
  close() {},

  draw(ctx, layer, { map, fit }) {
    const { masks: shown, vis } = layer;
    if (!shown) return;
    const props = vis.props ?? {};
    color(layer);
    ctx.save();
    ctx.globalAlpha = (props.opacity ?? OPACITY) / 100;
    ctx.imageSmoothingEnabled = false;
    const put = (canvas, [x, y, w, h]) => {
      const left = map.x(x),
        width = map.x(x + w) - left;
      ctx.save();
      ctx.translate(left, map.y(y));
      // a mirrored picture's masks are mirrored with it
      if (width < 0) ctx.scale(-1, 1);
      ctx.drawImage(canvas, 0, 0, Math.abs(width), h * map.k);
      ctx.restore();
    };
    if (shown.classes) put(shown.classes.canvas, covered(shown.classes, fit, props.fit));
    for (const m of shown.found ?? []) put(m.canvas, m.box);
    ctx.restore();
    if (props.labels === false) return;
    ctx.font = FONT;
    (shown.found ?? []).forEach((m, i) => {
      const [x, y, w] = m.box;
      const text = [m.label, m.id, m.score == null ? null : number(m.score, 2)].filter((p) => p != null).join("  ");
      if (text) tag(ctx, text, Math.min(map.x(x), map.x(x + w)), map.y(y), colorOf(layer, m, i));
    });
  },

  // The class, or the objects, at a place of the picture.
  under(layer, x, y) {
    const { masks: shown, size } = layer;
    if (!shown) return [];
    if (shown.classes) {
      const value = at(shown.classes, covered(shown.classes, size, layer.vis.props?.fit), x, y);
      return value ? [`class ${value}`] : [];
    }
    return shown.found.flatMap((m) => {
      if (!at(m, m.box, x, y)) return [];
      return [m.label || "object", ...(m.score == null ? [] : [`score ${number(m.score, 4)}`])].concat(
        m.id == null ? [] : [`id ${m.id}`],
      );
    });
  },
};

const object = (m) => ({ ...unpack(m), box: m.box, label: m.label, score: m.score, id: m.id });

// Values from runs of a value and its number.
export function unpack({ width, height, runs }) {
  const values = new Uint8Array(width * height);
  let at = 0;
  for (let i = 0; i + 1 < runs.length; i += 2) {
    values.fill(runs[i], at, at + runs[i + 1]);
    at += runs[i + 1];
  }
  return { width, height, values };
}

// The part of the picture that numbers of classes lie over: [x, y, width, height].
export function covered({ width, height }, picture, fit) {
  const { width: w, height: h } = picture;
  if (fit === "whole" || width !== height) return [0, 0, w, h];
  const side = fit === "crop" ? Math.min(w, h) : Math.max(w, h);
  return [(w - side) / 2, (h - side) / 2, side, side];
}

function at({ width, height, values }, [x, y, w, h], px, py) {
  const i = Math.floor(((px - x) / w) * width),
    j = Math.floor(((py - y) / h) * height);
  return i >= 0 && j >= 0 && i < width && j < height ? values[j * width + i] : 0;
}

const colorOf = ({ vis, index }, m, i) => seriesColor(null, Number.isInteger(m.id) ? m.id : (vis.color ?? index) + i);

// Each mask as a canvas, once for a message and a theme.
function color(layer) {
  const theme = seriesColor(null, 0);
  if (layer.drawnFor === theme) return;
  layer.drawnFor = theme;
  const { classes, found } = layer.masks;
  if (classes) classes.canvas = painted(classes, (v) => shade(parse(seriesColor(null, v - 1)), v - 1));
  (found ?? []).forEach((m, i) => (m.canvas = painted(m, () => parse(colorOf(layer, m, i)))));
}

// There are eight colours, and more classes: each further round is darker or lighter, so that no two of 32 are alike.
const SHADES = [1, 0.6, 0.8, 0.4];

export function shade([r, g, b, a], index) {
  const k = SHADES[Math.floor(index / 8) % SHADES.length];
  return [...[r, g, b].map((c) => Math.round(c * k)), a];
}

function painted({ width, height, values }, colorOfValue) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [Math.max(width, 1), Math.max(height, 1)];
  const ctx = canvas.getContext("2d");
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

const parse = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16)).concat(255);
