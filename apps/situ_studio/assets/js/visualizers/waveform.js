// Audio: columns of its extremes, around zero.

import { valueText } from "../page/number_text.js";
import { line } from "./line.js";
import * as paint from "./paint.js";

export const waveform = {
  ...line,
  id: "waveform",
  // the axis is symmetric around zero
  symmetric: true,

  draw(ctx, { series }, { view, x, y, color, ratio }) {
    paint.paintWave(ctx, series, view, x, y, { color, ratio });
  },

  // Returns the samples at the cursor, of each drawn channel.
  legendText({ series }, reading, apart) {
    const said = [...reading.values.values()].map((exact) => valueText(exact, apart)).join(" / ");
    return series.together ? `${said} (drawn: all channels, zoom in for this one)` : said;
  },

  // Returns the channels to play: all of them, or the drawn one.
  audibleChannel: ({ stream, props }) => {
    if (props?.mute || props?.visible === false) return null;
    const one = Number(props?.channel) || 0;
    return { stream, channel: props?.solo && one ? one - 1 : "all" };
  },
};
