// Draws an image. Of the images that arrive while one is being decoded, only the newest is kept.

import { KIND } from "../data/frames.js";
import { formatDuration } from "../time/text.js";
import { createBitmap } from "./pixels.js";

// Images that are older than this at the cursor show their age.
const OLD = 1e9;

export const image = {
  id: "image",
  panel: "image",

  // Accepts a frame; changed() is called when there is something new to draw.
  acceptFrame(layer, frame, changed) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    if (frame.kind === KIND.image) return decodeImage(layer, frame, changed);
    layer.generation = (layer.generation ?? 0) + 1;
    layer.frame = null;
    this.close(layer);
    changed();
  },

  // Called after the properties have changed: the image may have to be decoded again.
  restyle() {},

  close(layer) {
    if (!layer.picture?.borrowed) layer.picture?.image.close();
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

  describeAt: () => [],

  // Yields the size, age and value under the mouse, for the corner of the panel.
  *imageFacts({ picture, at, vis, video }, cursor, point) {
    const { width, height, values } = picture;
    yield `${width} × ${height}`;
    if (video) yield* video.facts(cursor);
    if (!video?.source?.pending && cursor - at >= OLD) yield `${formatDuration(cursor - at)} old`;
    const [x, y] = (point ?? []).map(Math.floor);
    if (!values || !(x >= 0 && y >= 0 && x < width && y < height)) return;
    yield `(${x}, ${y}) = ${this.readingText(values[y * width + x], picture, vis)}`;
  },

  /** @param {number} value @param {object} [_picture] @param {object} [_vis] */
  readingText: (value, _picture, _vis) => String(value),

  depthStyle: () => null,
};

export async function decodeImage(layer, frame, changed) {
  const { drawer } = layer;
  if (drawer.keeps) layer.frame = frame;
  if (layer.decoding) {
    layer.waiting = frame;
    return;
  }
  layer.decoding = true;
  const generation = layer.generation ?? 0;
  try {
    const picture = await createBitmap(frame, drawer.depthStyle(layer.vis.props));
    if (generation === (layer.generation ?? 0)) {
      drawer.close(layer);
      layer.picture = picture;
      layer.at = frame.at;
    } else picture.image.close();
  } catch (error) {
    layer.error = `image cannot be shown: ${error.message}`;
  }
  layer.decoding = false;
  const next = layer.waiting;
  layer.waiting = null;
  if (next) decodeImage(layer, next, changed);
  changed();
}
