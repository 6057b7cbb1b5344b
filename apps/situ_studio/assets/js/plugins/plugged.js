// The drawing code of a plug-in: its ES module, loaded from the plug-in's own folder, and a guard around every call of
// it. A failure shows in its panel; the others work on.
//
// The module exports `open(host)`, which gives an object with (all but `draw` may be missing):
//   accept({data, rows, sampled, at})   the message at the cursor, or the rows of the past
//   draw(ctx, scene)                    scene: {width, height, options, theme, map} (map: over pictures)
//   under(x, y, k)                      lines of text for what lies under the mouse
//   close()
// host: {options(), changed(), theme(name), el (of panels of its own), format(number)}

import { KIND } from "../data/wire.js";
import { number } from "../page/number_text.js";
import { theme, seriesColor } from "../page/theme.js";

const loaded = new Map();

// Scripts come from the folders of plug-ins only, whatever a layout says.
function load(url) {
  if (!/^\/plugins\/[a-z0-9-]+\/[\w./-]+$/.test(url) || url.includes(".."))
    return Promise.reject(new Error(`${url} is no script of a plug-in`));
  if (!loaded.has(url)) loaded.set(url, import(new URL(url.slice(1), document.baseURI).href));
  return loaded.get(url);
}

export class Plugged {
  // changed(): it wants to be drawn again
  constructor(vis, changed, el) {
    Object.assign(this, { vis, changed, el });
    load(vis.script.url).then(
      (module) => this.open(module),
      (error) => this.fail("its script cannot be loaded", error),
    );
  }

  open(module) {
    if (this.gone) return;
    if (typeof module.open !== "function") return this.fail("its script exports no open(host)");
    this.call("open", () => {
      this.plug = module.open({
        options: () => this.options(),
        changed: () => this.changed(),
        theme,
        color: (index) => seriesColor(this.vis.props?.color, index ?? this.vis.color ?? 0),
        format: number,
        el: this.el,
      });
    });
    if (this.error) return;
    if (!this.plug) return this.fail("open(host) gave nothing that could draw");
    if (this.told) this.tell();
    this.changed();
  }

  options() {
    return { ...this.vis.script.options, ...this.vis.props };
  }

  fail(what, error) {
    this.error = `the plug-in ${this.vis.script.plugin}: ${what}${error ? `: ${error.message ?? error}` : ""}`;
    console.error(this.error, error);
    this.changed();
  }

  // A call of the plug-in's code; what it answers, or undefined when it fails.
  call(name, run) {
    try {
      return run();
    } catch (error) {
      this.fail(`${name} failed`, error);
    }
  }

  accept(frame) {
    this.refused = frame.kind === KIND.error ? frame.message : null;
    this.told = frame.kind === KIND.json ? { ...frame.value, at: frame.at } : {};
    this.at = frame.at;
    if (this.plug) this.tell();
  }

  // A new message is a new chance for one that failed at the last.
  tell() {
    this.error = null;
    this.call("accept", () => this.plug.accept?.(this.told));
  }

  draw(ctx, scene) {
    if (!this.plug || this.error) return;
    ctx.save();
    this.call("draw", () => this.plug.draw?.(ctx, { ...scene, options: this.options(), theme: theme() }));
    ctx.restore();
  }

  under(x, y, k) {
    if (!this.plug || this.error) return [];
    const lines = this.call("under", () => this.plug.under?.(x, y, k)) ?? [];
    return [lines].flat().slice(0, 8).map(String);
  }

  problem() {
    return this.error ?? this.refused ?? null;
  }

  close() {
    this.gone = true;
    if (this.plug) this.call("close", () => this.plug.close?.());
  }
}

// As one of the drawers of a picture's panel.
export const plugged = {
  id: "plugged",
  panel: "image",

  accept(layer, frame, changed) {
    layer.plug ??= new Plugged(layer.vis, changed);
    layer.plug.accept(frame);
    changed();
  },

  restyle(layer, changed) {
    layer.plug ??= new Plugged(layer.vis, changed);
    layer.plug.vis = layer.vis;
  },

  close: (layer) => layer.plug?.close(),

  draw(ctx, layer, scene) {
    layer.plug?.draw(ctx, scene);
    layer.error = layer.plug?.problem();
  },

  under: (layer, x, y, k) => layer.plug?.under(x, y, k) ?? [],
};
