// Maps of numbers: a line for each key.

import { compareNames } from "../data/series.js";
import { line } from "./line.js";

export const lines = {
  ...line,
  id: "lines",

  lineEntries: (layer) =>
    [...layer.channel.lines]
      .sort(([a], [b]) => compareNames(a, b))
      .map(([name, series]) => ({ layer, name, series })),
};
