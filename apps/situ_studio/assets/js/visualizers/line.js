// One number over time: a line, or columns of extremes if there are more messages than pixels.

import { formatNumber, valueText } from "../page/number_text.js";
import * as paint from "./paint.js";

export const line = {
  id: "line",
  panel: "plot",

  lineEntries: (layer) => [{ layer, name: "", series: layer.channel.series }],

  valueExtent: ({ series }, view) => series.valueExtent(view[0], view[1]),

  draw(ctx, { series }, { view, x, y, color, ratio, props }) {
    const { interpolation, width, markers, marker, size } = props;
    paint.paintLine(ctx, series, view, x, y, {
      color,
      ratio,
      width,
      step: interpolation === "step",
      joined: interpolation !== "none",
      points: markers === true || interpolation === "none",
      marker: markers === true ? marker : "circle",
      size: markers === true ? size : undefined,
    });
  },

  // reading: the exact values at the cursor (`ValueChannel`); apart: the smallest difference that the text must show
  legendText({ layer, name }, reading, apart) {
    const exact = reading.values.get(name);
    if (exact === undefined) return "";
    const { unit, digits } = layer.vis.props ?? {};
    const text = digits == null ? valueText(exact, apart) : formatNumber(Number(exact), digits);
    return text + (unit ? " " + unit : "");
  },
};
