// The merged view: the layers of all annotators below each other, and a strip that shows where they agree.

import { showToast } from "../page/toast.js";
import { themeColors } from "../page/theme.js";
import { ROW, drawAnnotation } from "./draw.js";

// The name of the row that shows where the layers agree.
const AGREEMENT = "agree?";

/** @typedef {{track: string, from: number, to: number, agree: boolean}} Segment */

// Returns the next (by = 1) or previous (by = -1) disagreement of any track from a time on, or null.
/** @param {Segment[]} segments @param {number} t @param {number} by @returns {Segment | null} */
export function nextDisagreement(segments, t, by) {
  const all = segments.filter((s) => !s.agree).sort((a, b) => a.from - b.from);
  const later = all.filter((s) => (by > 0 ? s.from > t : s.from < t));
  return (by > 0 ? later[0] : later[later.length - 1]) ?? null;
}

// Returns the text of the toolbar: the kappas and the number of disagreements.
export function agreementText({ layers, segments }) {
  const kappas = layers.map(({ stream, kappa }) => `${stream}: κ ${kappa == null ? "undefined" : kappa.toFixed(2)}`);
  const differ = segments.filter((s) => !s.agree).length;
  return `${kappas.join(", ")}; ${differ} disagreement${differ === 1 ? "" : "s"}`;
}

export class Merged {
  constructor(panel) {
    this.panel = panel;
    this.active = false;
    /** @type {{layers: {stream: string, kappa: number | null, items: any[]}[], segments: Segment[]}} */
    this.data = { layers: [], segments: [] };
  }

  toggle() {
    this.active = !this.active;
    if (this.active) this.request();
    else this.redraw();
  }

  request() {
    this.panel.app.options.push?.("annotation_merged", {});
  }

  // Called when the open layer has changed.
  update() {
    if (this.active) this.request();
  }

  show({ layers, segments }) {
    if (!layers.length) {
      this.active = false;
      showToast("There is no other layer with the same attributes. Add my own layer (a) creates one");
      return this.redraw();
    }
    const toRelative = (a) => ({
      ...a,
      from: this.panel.app.client.toRelative(BigInt(a.from)),
      to: this.panel.app.client.toRelative(BigInt(a.to)),
    });
    this.data = {
      layers: layers.map((l) => ({ ...l, items: l.items.map(toRelative) })),
      segments: segments.map(toRelative),
    };
    this.redraw();
  }

  redraw() {
    this.panel.tools.update();
    this.panel.fitHeight();
    this.panel.app.scheduleDraw(this.panel);
  }

  // Adds the rows of the other layers and of the agreement below each track.
  extendRows(rows) {
    if (!this.active) return rows;
    return rows.flatMap((row, i) => {
      const last = rows[i + 1]?.track !== row.track;
      if (!last) return [row];
      const others = this.data.layers.map(({ stream }) => ({ ...row, first: false, layer: stream }));
      return [row, ...others, { ...row, first: false, layer: AGREEMENT }];
    });
  }

  // Draws a row that is not part of the open layer.
  drawRow(ctx, { track, layer, attribute }, timeToX, y) {
    const { state } = this.panel;
    const found = this.data.layers.find((l) => l.stream === layer);
    if (found) {
      for (const a of found.items)
        if (a.track === track)
          drawAnnotation(ctx, { ...a, id: undefined }, timeToX, y, { state, attribute, selected: null });
      return;
    }
    const c = themeColors();
    for (const s of this.data.segments) {
      if (s.track !== track) continue;
      const left = timeToX(s.from);
      ctx.fillStyle = s.agree ? c.axis : c.warn;
      const height = s.agree ? 4 : ROW - 10;
      ctx.fillRect(left, y + (ROW - height) / 2, Math.max(timeToX(s.to) - left, 2), height);
    }
  }

  // Goes to the next or previous disagreement, and selects its time.
  step(by) {
    const { time } = this.panel.app;
    const { cursor } = time.get();
    const next = nextDisagreement(this.data.segments, cursor, by);
    if (!next) return showToast(by > 0 ? "There is no later disagreement" : "There is no earlier disagreement");
    this.panel.track = next.track;
    time.dispatch({ type: "select", from: next.from, to: next.to });
    time.dispatch({ type: "nudge", by: next.from - cursor });
    this.panel.tools.update();
  }
}
