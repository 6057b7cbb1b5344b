// One number over time: a line, or columns between the extremes where there are more messages than pixels.

import { number, valueText } from "../page/number_text.js";
import * as paint from "./paint.js";

export const line = {
  id: "line",
  panel: "plot",

  entries: (layer) => [{ layer, name: "", series: layer.channel.series }],

  extent: ({ series }, view) => series.extent(view[0], view[1]),

  draw(ctx, { series }, { view, x, y, color, ratio, props }) {
    const { interpolation, width, markers, marker, size } = props;
    paint.line(ctx, series, view, x, y, {
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

  // told: the exact values at the cursor (`ValueChannel`); apart: the least difference that the text must show.
  text({ layer, name }, told, apart) {
    const exact = told.values.get(name);
    if (exact === undefined) return "";
    const { unit, digits } = layer.vis.props ?? {};
    const text = digits == null ? valueText(exact, apart) : number(Number(exact), digits);
    return text + (unit ? " " + unit : "");
  },
};
