// The kinds of panels, by their names in layouts.

import { PlotPanel } from "./plot.js";
import { LanesPanel } from "./lanes.js";
import { ImagePanel } from "./image.js";
import { SpacePanel } from "./space.js";
import { PluginPanel } from "./plugin.js";
import { MapPanel } from "./map.js";
import { WHOLE } from "../visualizers/index.js";

const KINDS = {
  plot: PlotPanel,
  lanes: LanesPanel,
  image: ImagePanel,
  space: SpacePanel,
  own: PluginPanel,
  map: MapPanel,
  ...WHOLE,
};

export const isTimeline = (kind) => kind === "plot" || kind === "lanes";

// Creates the view of a panel; returns null for an unknown kind.
export function openPanel(kind, el, app, config) {
  const Kind = KINDS[kind];
  return Kind ? new Kind(el, app, config) : null;
}
