// Maps of numbers: a line for each key.

import { byName } from "../data/series.js";
import { line } from "./line.js";

export const lines = {
  ...line,
  id: "lines",

  entries: (layer) =>
    [...layer.channel.lines].sort(([a], [b]) => byName(a, b)).map(([name, series]) => ({ layer, name, series })),
};
