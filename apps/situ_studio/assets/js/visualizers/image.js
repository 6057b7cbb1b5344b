// A picture as it came. Of those that arrive while one is decoded only the newest is kept.

import { KIND } from "../data/wire.js";
import { duration } from "../time/text.js";
import { bitmap } from "./pixels.js";

// A picture that is older than this at the cursor says so.
const OLD = 1e9;

export const image = {
  id: "image",
  panel: "image",

  // A frame has come; changed() when there is something new to draw.
  accept(layer, frame, changed) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    if (frame.kind === KIND.image) return decode(layer, frame, changed);
    layer.generation = (layer.generation ?? 0) + 1;
    layer.frame = null;
    this.close(layer);
    changed();
  },

  // The properties have changed: what is there already may have to be decoded once more.
  restyle() {},

  close(layer) {
    layer.picture?.image.close();
    layer.picture = null;
  },

  draw(ctx, { picture, vis }, { fit }) {
    if (!picture) return;
    ctx.save();
    if (vis.props?.flip) {
      ctx.translate(fit.x + picture.width * fit.k, fit.y);
      ctx.scale(-1, 1);
    } else ctx.translate(fit.x, fit.y);
    ctx.drawImage(picture.image, 0, 0, picture.width * fit.k, picture.height * fit.k);
    ctx.restore();
  },

  under: () => [],

  // Size, age and value under the mouse, for the corner of the panel.
  *facts({ picture, at, vis }, cursor, point) {
    const { width, height, values } = picture;
    yield `${width} × ${height}`;
    if (cursor - at >= OLD) yield `${duration(cursor - at)} old`;
    const [x, y] = (point ?? []).map(Math.floor);
    if (!values || !(x >= 0 && y >= 0 && x < width && y < height)) return;
    yield `(${x}, ${y}) = ${this.reading(values[y * width + x], picture, vis)}`;
  },

  reading: (value) => String(value),

  look: () => null,
};

export async function decode(layer, frame, changed) {
  const { drawer } = layer;
  if (drawer.keeps) layer.frame = frame;
  if (layer.decoding) {
    layer.waiting = frame;
    return;
  }
  layer.decoding = true;
  const generation = layer.generation ?? 0;
  try {
    const picture = await bitmap(frame, drawer.look(layer.vis.props));
    if (generation === (layer.generation ?? 0)) {
      drawer.close(layer);
      layer.picture = picture;
      layer.at = frame.at;
    } else picture.image.close();
  } catch (error) {
    layer.error = `picture cannot be shown: ${error.message}`;
  }
  layer.decoding = false;
  const next = layer.waiting;
  layer.waiting = null;
  if (next) decode(layer, next, changed);
  changed();
}
