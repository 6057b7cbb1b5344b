// Loads the ES module of a plug-in from its folder, and guards every call. A failure is shown in its panel; other
// panels keep working.
//
// The module exports `open(host)`, which returns an object (all methods but `draw` are optional):
//   accept({data, rows, sampled, at})   the message at the cursor, or the rows of the past
//   draw(ctx, scene)                    scene: {width, height, options, theme, map} (map: over images)
//   under(x, y, k)                      lines of text for the mouse position
//   close()
// host: {options(), changed(), theme(name), el (of panels of kind "own"), format(number)}

import { KIND } from "../data/frames.js";
import { formatNumber } from "../page/number_text.js";
import { themeColors, seriesColor } from "../page/theme.js";

const loaded = new Map();

// Loads a script. Only scripts in plug-in folders are allowed, whatever the layout contains.
function loadScript(url) {
  if (!/^\/plugins\/[a-z0-9-]+\/[\w./-]+$/.test(url) || url.includes(".."))
    return Promise.reject(new Error(`${url} is not the script of a plug-in`));
  if (!loaded.has(url)) loaded.set(url, import(new URL(url.slice(1), document.baseURI).href));
  return loaded.get(url);
}

export class PluginDrawer {
  // changed() requests a redraw
  constructor(vis, changed, el) {
    this.vis = vis;
    this.changed = changed;
    this.el = el;
    loadScript(vis.script.url).then(
      (module) => this.openModule(module),
      (error) => this.showFailure("its script cannot be loaded", error),
    );
  }

  openModule(module) {
    if (this.gone) return;
    if (typeof module.open !== "function") return this.showFailure("its script does not export open(host)");
    this.callPlugin("open", () => {
      this.plug = module.open({
        options: () => this.mergedOptions(),
        changed: () => this.changed(),
        theme: themeColors,
        color: (index) => seriesColor(this.vis.props?.color, index ?? this.vis.color ?? 0),
        format: formatNumber,
        el: this.el,
      });
    });
    if (this.error) return;
    if (!this.plug) return this.showFailure("open(host) did not return an object");
    if (this.data) this.passData();
    this.changed();
  }

  mergedOptions() {
    return { ...this.vis.script.options, ...this.vis.props };
  }

  showFailure(what, error) {
    this.error = `the plug-in ${this.vis.script.plugin}: ${what}${error ? `: ${error.message ?? error}` : ""}`;
    console.error(this.error, error);
    this.changed();
  }

  // Calls the plug-in's code; returns undefined if it fails.
  callPlugin(name, run) {
    try {
      return run();
    } catch (error) {
      this.showFailure(`${name} failed`, error);
    }
  }

  acceptFrame(frame) {
    this.refused = frame.kind === KIND.error ? frame.message : null;
    this.data = frame.kind === KIND.json ? { ...frame.value, at: frame.at } : {};
    this.at = frame.at;
    if (this.plug) this.passData();
  }

  // A plug-in that failed is called again with the next message.
  passData() {
    this.error = null;
    this.callPlugin("accept", () => this.plug.accept?.(this.data));
  }

  draw(ctx, scene) {
    if (!this.plug || this.error) return;
    ctx.save();
    this.callPlugin("draw", () =>
      this.plug.draw?.(ctx, { ...scene, options: this.mergedOptions(), theme: themeColors() }),
    );
    ctx.restore();
  }

  describeAt(x, y, k) {
    if (!this.plug || this.error) return [];
    const lines = this.callPlugin("under", () => this.plug.under?.(x, y, k)) ?? [];
    return [lines].flat().slice(0, 8).map(String);
  }

  errorText() {
    return this.error ?? this.refused ?? null;
  }

  close() {
    this.gone = true;
    if (this.plug) this.callPlugin("close", () => this.plug.close?.());
  }
}

// The plug-in as a visualizer of an image panel.
export const pluginVisualizer = {
  id: "plugged",
  panel: "image",

  acceptFrame(layer, frame, changed) {
    layer.plug ??= new PluginDrawer(layer.vis, changed);
    layer.plug.acceptFrame(frame);
    changed();
  },

  restyle(layer, changed) {
    layer.plug ??= new PluginDrawer(layer.vis, changed);
    layer.plug.vis = layer.vis;
  },

  close: (layer) => layer.plug?.close(),

  draw(ctx, layer, scene) {
    layer.plug?.draw(ctx, scene);
    layer.error = layer.plug?.errorText();
  },

  describeAt: (layer, x, y, k) => layer.plug?.describeAt(x, y, k) ?? [],
};
