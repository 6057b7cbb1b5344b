// The frequencies of audio over time: a column for each segment, computed in a worker.

import { formatNumber } from "../page/number_text.js";
import { computeLevels } from "../spectrogram/fft.js";
import { getContext2d, scriptAddress } from "../page/dom.js";

const MOST_COLUMNS = 4000;
// From quiet to loud, readable without distinguishing red from green.
const COLORS = [
  [0, 0, 4, 0],
  [66, 10, 104, 150],
  [147, 38, 103, 220],
  [221, 81, 58, 245],
  [252, 165, 10, 255],
  [252, 255, 164, 255],
];

// The worker's script is in the same folder as this script.
const SCRIPT = scriptAddress() ?? "";

/** @type {Worker | null} */
let worker = null;
let asked = 0;
const waiting = new Map();

function requestLevels(samples, count, n, done) {
  if (!worker) {
    worker = new Worker(new URL("spectrogram-worker.js", SCRIPT));
    worker.onmessage = ({ data: { id, found } }) => {
      waiting.get(id)?.(found);
      waiting.delete(id);
    };
  }
  waiting.set(++asked, done);
  worker.postMessage({ id: asked, samples: samples.slice(), count, n });
}

// The drawn columns, with the interface that the legend uses.
class Spectra {
  constructor(columns, rate, n) {
    this.columns = columns;
    this.rate = rate;
    this.n = n;
    this.sampled = false;
    this.step =
      columns.length > 1 ? Math.min(...columns.slice(1).map((c, i) => c.t - columns[i].t)) : (n * 1e9) / rate;
  }

  get length() {
    return this.columns.length;
  }

  indexAt(t) {
    return this.columns.findLastIndex((c) => c.t <= t);
  }

  messageAge(i, t) {
    const age = t - this.columns[i].t;
    return age > 2 * this.step ? age : 0;
  }
}

function columnCanvas(levels) {
  const out = document.createElement("canvas");
  [out.width, out.height] = [1, levels.length];
  const ctx = getContext2d(out);
  const image = ctx.createImageData(1, levels.length);
  levels.forEach((v, i) => image.data.set(levelColor(v / 255), 4 * (levels.length - 1 - i)));
  ctx.putImageData(image, 0, 0);
  return out;
}

function levelColor(level) {
  const at = level * (COLORS.length - 1),
    i = Math.min(Math.floor(at), COLORS.length - 2);
  return COLORS[i].map((c, k) => c + (COLORS[i + 1][k] - c) * (at - i));
}

// Sends new audio to the worker; the result is drawn with the next frame.
function requestColumns(layer) {
  const { sounds } = layer.channel;
  if (!sounds || sounds === layer.taken) return;
  layer.taken = sounds;
  const { t, base, samples, rate, from, count } = sounds;
  if (!count) {
    if (from === -Infinity) layer.spectra = null;
    return;
  }
  const n = samples.length / count;
  requestLevels(samples, count, n, (found) => {
    const next = Array.from(t, (time, i) => {
      const levels = found.subarray((i * n) / 2, ((i + 1) * n) / 2);
      return { t: time + base, levels, canvas: columnCanvas(levels) };
    });
    const kept = (layer.spectra?.columns ?? []).filter((c) => c.t < Math.max(from, -Infinity) && c.t < next[0].t);
    layer.spectra = new Spectra(kept.slice(-MOST_COLUMNS).concat(next), rate, n);
    layer.redraw?.();
  });
}

export const spectrogram = {
  id: "spectrogram",
  panel: "plot",

  lineEntries(layer) {
    requestColumns(layer);
    return [{ layer, name: "", series: layer.spectra ?? new Spectra([], 16000, 2) }];
  },

  valueExtent: ({ series }) => (series.length ? [0, series.rate / 2] : null),

  draw(ctx, { series }, { view, x, y }) {
    const top = y(series.rate / 2),
      height = y(0) - top;
    const { columns, step } = series;
    ctx.imageSmoothingEnabled = false;
    columns.forEach(({ t, canvas }, i) => {
      // until the next column, if it is not farther than a step
      const end = Math.min(columns[i + 1]?.t ?? Infinity, t + step);
      if (end < view[0] || t > view[1]) return;
      ctx.drawImage(canvas, x(t), top, Math.max(x(end) - x(t), 1) + 0.5, height);
    });
  },

  // Returns the loudest frequency of the audio at the cursor.
  legendText(_entry, { samples, rate }) {
    const found = computeLevels(samples, 1, samples.length);
    let best = 1;
    for (let k = 2; k < found.length; k++) if (found[k] > found[best]) best = k;
    if (!found[best]) return "silent";
    return `loudest ${formatNumber((best * rate) / samples.length, 3)} Hz`;
  },
};
