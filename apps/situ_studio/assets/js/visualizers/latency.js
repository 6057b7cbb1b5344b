// Latency: a stem a message, in the warning colour above the limit.

import { valueText } from "../page/number_text.js";
import { theme } from "../page/theme.js";
import { line } from "./line.js";
import * as paint from "./paint.js";

export const latency = {
  ...line,
  id: "latency",

  // from zero
  extent({ series }, view) {
    const range = series.extent(view[0], view[1]);
    return range && [Math.min(range[0], 0), Math.max(range[1], 0)];
  },

  draw(ctx, { series }, { view, x, y, color, ratio, props }) {
    const threshold = props.threshold_ms ?? 50;
    paint.stems(ctx, series, view, x, y, { color, warn: theme().warn, threshold, ratio });
  },

  text: (_entry, told, apart) => `${valueText(told.values.get(""), apart)} ms`,
};
