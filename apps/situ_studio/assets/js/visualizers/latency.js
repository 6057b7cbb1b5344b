// Latency: a stem for each message, in the warning color above the limit.

import { valueText } from "../page/number_text.js";
import { themeColors } from "../page/theme.js";
import { line } from "./line.js";
import * as paint from "./paint.js";

export const latency = {
  ...line,
  id: "latency",

  // from zero
  valueExtent({ series }, view) {
    const range = series.valueExtent(view[0], view[1]);
    return range && [Math.min(range[0], 0), Math.max(range[1], 0)];
  },

  draw(ctx, { series }, { view, x, y, color, ratio, props }) {
    const threshold = props.threshold_ms ?? 50;
    paint.paintStems(ctx, series, view, x, y, { color, warn: themeColors().warn, threshold, ratio });
  },

  legendText: (_entry, reading, apart) => `${valueText(reading.values.get(""), apart)} ms`,
};
