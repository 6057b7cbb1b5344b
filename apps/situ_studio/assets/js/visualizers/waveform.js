// Sound: columns between its extremes, about zero.

import { valueText } from "../page/number_text.js";
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

  // The sample at the cursor, of each channel that is drawn.
  text({ series }, told, apart) {
    const said = [...told.values.values()].map((exact) => valueText(exact, apart)).join(" / ");
    return series.together ? `${said} (drawn: all channels, zoom in for this one)` : said;
  },

  // The waveform that is heard while playing: all its channels, or the one that is drawn.
  sound: ({ stream, props }) => {
    if (props?.mute || props?.visible === false) return null;
    const one = Number(props?.channel) || 0;
    return { stream, channel: props?.solo && one ? one - 1 : "all" };
  },
};
