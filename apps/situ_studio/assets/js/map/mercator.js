// Web Mercator: the world is a square from 0 to 1, with x to the east and y to the south. Pure.

const RADIUS = 6378137;
export const EDGE = 85.0511287798066;

export const toX = (longitude) => (longitude + 180) / 360;

export function toY(latitude) {
  const phi = (Math.min(Math.max(latitude, -EDGE), EDGE) * Math.PI) / 180;
  return (1 - Math.asinh(Math.tan(phi)) / Math.PI) / 2;
}

export const toLongitude = (x) => x * 360 - 180;
export const toLatitude = (y) => (Math.atan(Math.sinh(Math.PI * (1 - 2 * y))) * 180) / Math.PI;

// Returns the length of a meter in units of the square at a latitude.
export function unitsPerMetre(latitude) {
  const phi = (Math.min(Math.abs(latitude), EDGE) * Math.PI) / 180;
  return 1 / (2 * Math.PI * RADIUS * Math.cos(phi));
}

// Returns the distance between two positions in meters, on a sphere.
export function groundDistance([lat1, lon1], [lat2, lon2]) {
  const rad = Math.PI / 180;
  const a =
    Math.sin(((lat2 - lat1) * rad) / 2) ** 2 +
    Math.cos(lat1 * rad) * Math.cos(lat2 * rad) * Math.sin(((lon2 - lon1) * rad) / 2) ** 2;
  return 2 * RADIUS * Math.asin(Math.min(1, Math.sqrt(a)));
}

// Returns the length in meters (1, 2 or 5 times a power of ten) and in pixels of a scale of at most `px` pixels.
export function roundScale(px, metresPerPx) {
  const most = px * metresPerPx;
  const power = 10 ** Math.floor(Math.log10(most));
  const metres = [5, 2, 1].map((k) => k * power).find((m) => m <= most) ?? power;
  return { metres, px: metres / metresPerPx };
}

// Returns the spacing of grid lines in degrees, at least `least`.
const STEPS = [0.0001, 0.0002, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60];
export const gridStep = (least) => STEPS.find((s) => s >= least) ?? 90;

// Lists the tiles that cover a part of the world: [{z, x, y, left, top, size}], in pixels of the canvas. `map` is
// {x, y} of the canvas's top left corner, and `px`, the size of the whole square in pixels.
export function visibleTiles({ x, y, px }, width, height) {
  const z = Math.min(Math.max(Math.round(Math.log2(px / 256)), 0), 19);
  const n = 2 ** z,
    size = px / n;
  const out = [];
  for (let ty = Math.max(0, Math.floor(y * n)); ty < n && (ty / n - y) * px < height; ty++)
    for (let tx = Math.floor(x * n); (tx / n - x) * px < width; tx++) {
      const wrapped = ((tx % n) + n) % n;
      out.push({ z, x: wrapped, y: ty, left: (tx / n - x) * px, top: (ty / n - y) * px, size });
      if (out.length >= 400) return out;
    }
  return out;
}
