// Every way to draw a stream, by the name the server's table gives it (`Situ.Studio.Visualizer`). One file each: what
// is drawn, what lies under the mouse, what the legend says. `panel` names the kind of panel that it draws in.
//
// plot:   entries(layer) -> [{layer, name, series}], draw(ctx, entry, scene), extent(entry, view),
//         text(entry, told, apart)
// lanes:  lanes(channel) -> names, draw(ctx, lane, scene), under(lane, time, slack) -> lines of text
// image:  accept(layer, frame, changed), draw(ctx, layer, scene), under(layer, x, y, k), facts(layer, x, y)
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

export const visualizers = new Map(ALL.map((v) => [v.id, v]));

// The panels of which one visualizer fills all.
export const WHOLE = { bars: BarsPanel, text: TextPanel, value: ValuePanel, log: LogPanel, xy: XYPanel };
