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

  text(entry, i) {
    const said = line.text(entry, i);
    return entry.series.together ? `${said} (all channels: zoom in for this one)` : said;
  },

  // The waveform that is heard while playing: all its channels, or the one that is drawn.
  sound: ({ stream, props }) => {
    if (props?.mute || props?.visible === false) return null;
    const one = Number(props?.channel) || 0;
    return { stream, channel: props?.solo && one ? one - 1 : "all" };
  },
};
