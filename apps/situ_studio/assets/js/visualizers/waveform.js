// Sound: the band between its extremes, about zero.

import { line } from "./line.js";
import * as paint from "./paint.js";

export const waveform = {
  ...line,
  id: "waveform",
  // the axis is the same on both sides of zero
  symmetric: true,

  draw(ctx, { series }, { view, x, y, color, ratio }) {
    paint.wave(ctx, series, view, x, y, { color, ratio });
  },

  // The waveform that is heard while playing.
  sound: ({ stream, channel, props }) =>
    props?.mute || props?.visible === false ? null : { stream, channel: channel ?? 0 },
};
