// Reads canvas colors from the style sheet, so that the dark and light themes are defined in one place.

import { changeSetting, onSetting } from "./settings.js";

const NAMES = [
  "bg",
  "panel",
  "grid",
  "axis",
  "text",
  "dim",
  "accent",
  "cursor",
  "sel-start",
  "sel-end",
  "warn",
  "on",
  "off",
];
// The space on both sides of every timeline; the left side follows its contents (`gutter.js`).
export const GUTTER = { left: 76, right: 14 };
export const FONT_FACE = 'Inter, "Segoe UI", system-ui, sans-serif';
export const FONT = `11px ${FONT_FACE}`;

/** @typedef {Record<string, string> & {series: string[]}} Theme the colors by name, and those of streams */

/** @type {Theme | null} */
let cache = null;
const listeners = new Set();

/** @returns {Theme} */
export function themeColors() {
  if (!cache) {
    const css = getComputedStyle(document.documentElement);
    const readColor = (name) => css.getPropertyValue(`--${name}`).trim();
    const named = Object.fromEntries(NAMES.map((name) => [name, readColor(name)]));
    cache = Object.assign(named, { series: Array.from({ length: 8 }, (_, i) => readColor(`s${i}`)) });
  }
  return cache;
}

export const setTheme = (name) => changeSetting("theme", name);

const systemTheme = () => (matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark");

onSetting((id, value) => {
  if (id === "theme") document.documentElement.dataset.theme = value === "system" ? systemTheme() : value;
  else if (id === "palette") document.documentElement.dataset.palette = value;
  else return;
  cache = null;
  for (const l of listeners) l();
});

export function onTheme(l) {
  listeners.add(l);
  return () => listeners.delete(l);
}

export function seriesColor(color, index) {
  const t = themeColors();
  if (typeof color === "string" && /^#[0-9a-fA-F]{6}$/.test(color)) return color;
  const i = Number.isInteger(color) ? color : index;
  return t.series[((i % 8) + 8) % 8];
}

// Returns the color index of a key, so that a track has the same color in every panel.
export const keyIndex = (name, otherwise) => (/^\d+$/.test(name) ? Number(name) : otherwise);

// Returns the theme's dark or light color, whichever is more readable on a color.
export function readableColor(color) {
  const t = themeColors();
  return contrastRatio(t.bg, color) >= contrastRatio(t.text, color) ? t.bg : t.text;
}

// Returns the contrast ratio of two colors (#rrggbb), from 1 to 21; text needs 4.5. W3C, WCAG 2.2, 1.4.3.
export function contrastRatio(a, b) {
  const [dark, light] = [relativeLuminance(a), relativeLuminance(b)].sort((x, y) => x - y);
  return (light + 0.05) / (dark + 0.05);
}

function relativeLuminance(hex) {
  const [r, g, b] = [1, 3, 5].map((i) => {
    const v = parseInt(hex.slice(i, i + 2), 16) / 255;
    return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

// Returns a stable color for a state's name; in lanes of several keys, the color of the key.
export function stateColor(label, cls, lane = null) {
  const t = themeColors();
  if (cls === "true" && lane != null) return t.series[lane % 8];
  if (cls === "true") return t.on;
  if (cls === "false") return t.off;
  if (cls === "text" || cls === "span" || cls === "many") return t.series[(lane ?? 0) % 8];
  let h = 0;
  for (let i = 0; i < label.length; i++) h = (h * 31 + label.charCodeAt(i)) | 0;
  return t.series[Math.abs(h) % 8];
}
