// Converts a received image of any pixel format to a bitmap that a canvas can draw.

import { PIXELS } from "../data/frames.js";
import { paintDepth, paintGray } from "./depth_colors.js";

// look: how depth is colored (`depth.js`), or null if 16 bits are shades of gray
export async function createBitmap(f, look) {
  if (f.pixels === PIXELS.jpeg || f.pixels === PIXELS.png) {
    const type = f.pixels === PIXELS.jpeg ? "image/jpeg" : "image/png";
    const image = await createImageBitmap(new Blob([f.data], { type }));
    // the picture of an exported page may be smaller than its message
    const [width, height] = f.shown ?? [image.width, image.height];
    return { image, width, height };
  }
  const { width, height } = f;
  const out = new ImageData(width, height);
  const extra = fillPixels(f, out.data, look);
  return { image: await createImageBitmap(out), width, height, ...extra };
}

export function fillPixels(f, rgba, look) {
  const n = f.width * f.height,
    d = f.data;
  switch (f.pixels) {
    case PIXELS.rgba:
      rgba.set(d.subarray(0, 4 * n));
      return {};
    case PIXELS.bgra:
    case PIXELS.rgb:
    case PIXELS.bgr: {
      const step = f.pixels === PIXELS.bgra ? 4 : 3;
      const [r, b] = f.pixels === PIXELS.rgb ? [0, 2] : [2, 0];
      for (let i = 0, p = 0, o = 0; i < n; i++, p += step, o += 4) {
        rgba[o] = d[p + r];
        rgba[o + 1] = d[p + 1];
        rgba[o + 2] = d[p + b];
        rgba[o + 3] = 255;
      }
      return {};
    }
    case PIXELS.gray8:
      for (let i = 0, o = 0; i < n; i++, o += 4) {
        rgba[o] = rgba[o + 1] = rgba[o + 2] = d[i];
        rgba[o + 3] = 255;
      }
      return {};
    case PIXELS.gray16: {
      const values = new Uint16Array(d.buffer.slice(d.byteOffset, d.byteOffset + 2 * n));
      if (look) return { values, unit: f.unit, range: paintDepth(values, rgba, look) };
      paintGray(values, rgba);
      return { values, unit: 0 };
    }
    default:
      throw new Error(`unknown pixel format ${f.pixels}`);
  }
}
