// Draws a mark at the time of each message.

import { lowerBound } from "../data/series.js";
import { markText } from "../data/lanes.js";

export const messages = {
  id: "messages",
  panel: "lanes",

  laneNames: () => [""],

  draw(ctx, { channel }, { view, x, y, h, color }) {
    const m = channel.marks;
    if (!m) return;
    ctx.fillStyle = color;
    let last = -1;
    for (let i = lowerBound(m.t, view[0]); i < m.t.length && m.t[i] <= view[1]; i++) {
      const px = Math.round(x(m.t[i]) * 2) / 2;
      if (px === last) continue;
      last = px;
      ctx.fillRect(px - 0.5, y + 2, 1, h - 4);
    }
  },

  describeAt: ({ channel }, t, slack, show) => (channel.marks ? markText(channel.marks, t, slack, show) : []),
};
