// One number over time: a line, and the band between the extremes where there are more messages than pixels.

import { number } from "../page/number_text.js";
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

  text({ layer, series }, i) {
    if (!Number.isFinite(series.last[i])) return "";
    const { unit, digits } = layer.vis.props ?? {};
    return number(series.last[i], digits ?? 5) + (unit ? " " + unit : "");
  },
};
