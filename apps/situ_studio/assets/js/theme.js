// Colours for canvases come from the style sheet, so that dark and light need one place only.

const NAMES = ["bg", "panel", "grid", "axis", "text", "dim", "accent", "cursor", "sel-start", "sel-end", "warn", "on", "off"];
export const GUTTER = { left: 76, right: 14 };
export const FONT = '11px Inter, "Segoe UI", system-ui, sans-serif';

let cache = null;
const listeners = new Set();

export function theme() {
  if (!cache) {
    const css = getComputedStyle(document.documentElement);
    cache = { series: [] };
    for (const n of NAMES) cache[n] = css.getPropertyValue(`--${n}`).trim();
    for (let i = 0; i < 8; i++) cache.series.push(css.getPropertyValue(`--s${i}`).trim());
  }
  return cache;
}

export function setTheme(name) {
  document.documentElement.dataset.theme = name;
  try {
    localStorage.setItem("situ:theme", name);
  } catch {
    // private windows may have no storage: the theme then lasts as long as the page
  }
  cache = null;
  for (const l of listeners) l();
}

export function onTheme(l) {
  listeners.add(l);
  return () => listeners.delete(l);
}

export function seriesColor(color, index) {
  const t = theme();
  if (typeof color === "string" && /^#[0-9a-fA-F]{6}$/.test(color)) return color;
  const i = Number.isInteger(color) ? color : index;
  return t.series[((i % 8) + 8) % 8];
}

// The number of the colour of a key: tracks have the same in every panel.
export const keyIndex = (name, otherwise) => (/^\d+$/.test(name) ? Number(name) : otherwise);

// A stable colour for a state's name; in lanes of several keys, that of the key.
export function stateColor(label, cls, lane = null) {
  const t = theme();
  if (cls === "true" && lane != null) return t.series[lane % 8];
  if (cls === "true") return t.on;
  if (cls === "false") return t.off;
  if (cls === "text" || cls === "span" || cls === "many") return t.series[(lane ?? 0) % 8];
  let h = 0;
  for (let i = 0; i < label.length; i++) h = (h * 31 + label.charCodeAt(i)) | 0;
  return t.series[Math.abs(h) % 8];
}
