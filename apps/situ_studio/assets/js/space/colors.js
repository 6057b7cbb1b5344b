// Colors by value: which numbers of a message determine the colors, and the range that the colors cover.

import { Color, DataTexture, LinearFilter, RGBAFormat, SRGBColorSpace } from "three";
import { COLORS } from "../visualizers/depth_colors.js";

export const MODES = { own: 0, one: 1, x: 2, y: 3, z: 4, distance: 5, value: 6 };

// Low values are cold, high values warm.
const RAMP = [...COLORS].reverse();

export function rampTexture() {
  const bytes = new Uint8Array(4 * RAMP.length);
  RAMP.forEach((c, i) => bytes.set([...c, 255], 4 * i));
  const texture = new DataTexture(bytes, RAMP.length, 1, RGBAFormat);
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.colorSpace = SRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}

export const rampCss = `linear-gradient(90deg, ${RAMP.filter((_, i) => i % 32 === 0)
  .map((c) => `rgb(${c})`)
  .join(", ")})`;
export const RAMP_COLORS = RAMP;

/** @param {number} value @param {number[]} span */
export function rampColor(value, [low, high]) {
  const t = Math.min(Math.max((value - low) / (high - low), 0), 1);
  const [r, g, b] = RAMP[Math.round(t * 255)];
  return new Color().setRGB(r / 255, g / 255, b / 255, SRGBColorSpace);
}

// Returns the color mode of an item with the layer's properties: "auto" uses its own colors, else its values, else
// its height.
export function colorMode(item, props) {
  const asked = props.color_by ?? "auto";
  if (asked === "value") return item.value ? "value" : "one";
  if (asked !== "auto") return asked;
  if (item.color) return "own";
  if (item.value) return "value";
  return item.kind === "points" && item.name !== "was here" ? "z" : "one";
}

const AXES = { x: 0, y: 1, z: 2 };

// Returns the range of the values that determine the colors, or the fixed range of the properties.
export function colorSpan(item, mode, props) {
  if (props.range === "fixed") {
    const [a, b] = [props.low ?? 0, props.high ?? 3];
    return a < b ? [a, b] : [b, a === b ? a + 1 : a];
  }
  let low = Infinity,
    high = -Infinity;
  const includeValue = (v) => {
    if (v < low) low = v;
    if (v > high) high = v;
  };
  const p = item.position;
  if (mode === "value") for (let i = 0; i < item.value.length; i++) includeValue(item.value[i]);
  else if (mode === "distance")
    for (let i = 0; i < p.length; i += 3)
      includeValue(Math.sqrt(p[i] * p[i] + p[i + 1] * p[i + 1] + p[i + 2] * p[i + 2]));
  else for (let i = AXES[mode] ?? 2; i < p.length; i += 3) includeValue(p[i]);
  if (!(low <= high)) return [0, 1];
  return high > low ? [low, high] : [low, low + 1];
}
