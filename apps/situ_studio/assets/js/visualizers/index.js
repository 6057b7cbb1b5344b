// All visualizers, by their names in the server's table (`Situ.Studio.Visualizer`). Each has its own file: it draws,
// describes the item under the mouse, and formats the legend. `panel` is the kind of panel that it draws in.
//
// plot:   lineEntries(layer) -> [{layer, name, series}], draw(ctx, entry, scene), valueExtent(entry, view),
//         legendText(entry, reading, apart)
// lanes:  laneNames(channel) -> names, draw(ctx, lane, scene), describeAt(lane, time, slack) -> lines of text
// image:  acceptFrame(layer, frame, changed), draw(ctx, layer, scene), describeAt(layer, x, y, k),
//         imageFacts(layer, x, y)
// others: a class that fills the panel by itself (el, app, config)

import { line } from "./line.js";
import { lines } from "./lines.js";
import { waveform } from "./waveform.js";
import { latency } from "./latency.js";
import { states, labels, spans } from "./segments.js";
import { messages } from "./messages.js";
import { image } from "./image.js";
import { depth } from "./depth.js";
import { shapes } from "./shapes.js";
import { masks } from "./masks.js";
import { spectrogram } from "./spectrogram.js";
import { BarsPanel } from "./bars.js";
import { TextPanel } from "./text.js";
import { ValuePanel } from "./value.js";
import { LogPanel } from "./log.js";
import { TablePanel } from "./table.js";
import { XYPanel } from "./xy.js";

const ALL = [
  line,
  lines,
  waveform,
  spectrogram,
  latency,
  states,
  labels,
  spans,
  messages,
  image,
  depth,
  shapes,
  masks,
];

/** @type {Map<string, any>} each kind of panel calls its own functions */
const visualizers = new Map(ALL.map((v) => [v.id, v]));

// Returns the visualizer with this name, or the usual one of the panel.
export const getVisualizer = (name, usual) => visualizers.get(name) ?? visualizers.get(usual);

// Panels that one visualizer fills.
export const WHOLE = {
  bars: BarsPanel,
  text: TextPanel,
  value: ValuePanel,
  log: LogPanel,
  table: TablePanel,
  xy: XYPanel,
};
