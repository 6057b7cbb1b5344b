// The kinds of panels, by the names that layouts give them.

import { PlotPanel } from "./plot.js";
import { LanesPanel } from "./lanes.js";
import { ImagePanel } from "./image.js";
import { SpacePanel } from "./space.js";
import { OwnPanel } from "./own.js";
import { MapPanel } from "./map.js";
import { WHOLE } from "../visualizers/index.js";

const KINDS = {
  plot: PlotPanel,
  lanes: LanesPanel,
  image: ImagePanel,
  space: SpacePanel,
  own: OwnPanel,
  map: MapPanel,
  ...WHOLE,
};

export const timeline = (kind) => kind === "plot" || kind === "lanes";

// The view of a panel, or null of a kind that this page does not know.
export function openPanel(kind, el, app, config) {
  const Kind = KINDS[kind];
  return Kind ? new Kind(el, app, config) : null;
}
