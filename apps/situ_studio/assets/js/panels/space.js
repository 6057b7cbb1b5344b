// A 3D panel: the objects of streams in space, from any point of view. The first such panel loads the drawing code.

import { KIND } from "../data/frames.js";
import { showTip } from "../page/tip.js";
import { seriesColor, themeColors } from "../page/theme.js";
import { scriptAddress } from "../page/dom.js";

const HERE = scriptAddress() ?? location.href;
/** @type {Promise<typeof import("../space/index.js")> | null} */
let drawing = null;
const loadDrawing = () => (drawing ??= import(new URL("space.js", HERE).href));

// The properties that change the server's data.
const ASKED = [
  ...["depth_as", "sparsity", "focal", "budget", "axis", "ray", "threshold", "seconds"],
  ...["text_as", "text_height"],
];

// Details are requested after nothing has moved for this many ms.
const REST = 250;

const TOOLS = [
  ["fit", "Fit", "Fit everything in view"],
  ["top", "Top", "View from above"],
  ["fly", "Fly", "Look around by dragging; w a s d to move, q e down and up"],
  ["follow", "Follow", "Follow the object that was clicked last"],
  ["measure", "Measure", "Click two positions to measure their distance"],
];

export class SpacePanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    this.layers = [];
    this.addElements();
    this.configure(config);
    this.observer = new ResizeObserver(() => this.app.scheduleDraw(this));
    this.observer.observe(el);
    (app.options.loadSpace ?? loadDrawing)().then(
      (space) => this.openStage(space),
      (error) => this.showFailure(`the 3D view could not be loaded: ${error.message}`),
    );
  }

  addElements() {
    this.el.classList.add("space-cell");
    const addChild = (tag, name) => {
      const child = this.el.appendChild(document.createElement(tag));
      child.className = name;
      return child;
    };
    this.canvas = addChild("canvas", "space-canvas");
    this.canvas.tabIndex = 0;
    this.info = addChild("div", "cell-info");
    const bar = addChild("div", "space-tools");
    bar.setAttribute("role", "toolbar");
    for (const [name, text, title] of TOOLS) {
      const button = bar.appendChild(document.createElement("button"));
      Object.assign(button, { type: "button", className: "space-tool", textContent: text, title });
      button.dataset.tool = name;
    }
    bar.addEventListener("click", (e) => this.useTool(e.target.closest("button")));
  }

  openStage(space) {
    if (this.gone) return;
    try {
      this.stage = space.openStage(this.canvas, {
        changed: () => this.app.scheduleDraw(this),
        pointed: (lines, x, y) => showTip(this, lines, x, y),
        theme: themeColors,
      });
    } catch (error) {
      return this.showFailure(error.message);
    }
    for (const layer of this.layers) this.putLayer(layer);
    this.app.scheduleDraw(this);
  }

  showFailure(text) {
    this.failure = text;
    this.app.scheduleDraw(this);
  }

  configure(config) {
    this.config = config;
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const props = Object.fromEntries(ASKED.filter((k) => k in (vis.props ?? {})).map((k) => [k, vis.props[k]]));
      const key = JSON.stringify([vis.viz, vis.stream, vis.path, props]);
      const layer = old.get(key) ?? this.openLayer(key, vis, props);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    for (const l of this.layers) this.putLayer(l);
    this.app.scheduleDraw(this);
  }

  openLayer(key, vis, props) {
    const layer = { key, vis };
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props };
    layer.channel = this.app.client.openChannel(spec, (frame) => this.acceptFrame(layer, frame), { instant: true });
    return layer;
  }

  closeLayer(layer) {
    this.dropDetail(layer);
    this.app.client.closeChannel(layer.channel);
    this.stage?.removeLayer(layer.key);
  }

  // Requests the visible points of clouds that are too large to be drawn in full, once the viewer has stopped
  // moving.
  refineLayer(layer) {
    const planes = this.stage.viewPlanes(layer.key)?.map((v) => Number(v.toPrecision(7)));
    const seen = planes ? planes.join() : null;
    if (layer.seen === seen) return;
    layer.seen = seen;
    clearTimeout(layer.resting);
    this.app.client.closeChannel(layer.near);
    layer.near = null;
    this.stage.hideThinned(layer.key, false);
    if (seen) layer.resting = setTimeout(() => this.requestDetail(layer, planes), REST);
  }

  requestDetail(layer, planes) {
    const { stream, viz, path } = layer.vis;
    const props = { ...layer.channel.spec.props, within: planes };
    const acceptDetail = (frame, channel) => {
      if (layer.near !== channel || frame.kind !== KIND.scene || frame.at !== layer.frame?.at) return;
      this.stage?.refineLayer(layer.key, frame);
      this.app.scheduleDraw(this);
    };
    layer.near = this.app.client.openChannel({ stream, viz, path, props }, acceptDetail, { instant: true });
  }

  dropDetail(layer) {
    clearTimeout(layer.resting);
    this.app.client.closeChannel(layer.near);
    layer.near = layer.seen = null;
    this.stage?.refineLayer(layer.key, null);
  }

  acceptFrame(layer, frame) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    layer.frame = frame.kind === KIND.scene || frame.kind === KIND.json ? frame : null;
    this.putLayer(layer);
    this.app.scheduleDraw(this);
  }

  // Passes a layer to the stage. A layer that cannot be drawn shows an error; the others are drawn.
  putLayer(layer) {
    if (!this.stage) return;
    this.dropDetail(layer);
    const { vis, frame, index } = layer;
    const props = { ...vis.props, color: seriesColor(vis.props?.color, vis.color ?? index ?? 0) };
    try {
      const named = { name: vis.name, short: vis.short, props, own: vis.props?.color != null };
      this.stage.putLayer(layer.key, { ...named, frame, changed: layer.drawn !== frame });
      layer.drawn = frame;
      layer.failure = null;
    } catch (error) {
      layer.failure = `${vis.short}: ${error.message}`;
      this.stage.removeLayer(layer.key);
    }
  }

  useTool(button) {
    if (!button || !this.stage) return;
    const on = this.stage.useTool(button.dataset.tool);
    for (const b of this.el.querySelectorAll(".space-tool")) {
      const name = b.dataset.tool;
      b.setAttribute("aria-pressed", String(on.includes(name)));
    }
    this.app.scheduleDraw(this);
  }

  render() {
    this.updateNote();
    const w = Math.round(this.el.clientWidth * devicePixelRatio),
      h = Math.round(this.el.clientHeight * devicePixelRatio);
    if (!this.stage || !w || !h) return;
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    for (const layer of this.layers) this.refineLayer(layer);
    this.stage.render(devicePixelRatio);
    this.drawn = (this.drawn ?? 0) + 1;
    const at = this.layers.map((l) => l.frame?.at).filter((t) => t != null);
    if (at.length) this.canvas.dataset.at = String(Math.max(...at));
    else delete this.canvas.dataset.at;
  }

  updateNote() {
    const problems = this.layers.flatMap((l) => [
      ...(l.error ? [`${l.vis.short}: ${l.error}`] : []),
      ...(l.failure ? [l.failure] : []),
      ...(l.frame?.problems ?? []).map((p) => `${l.vis.short}: ${p}`),
      ...(this.stage?.layerProblem(l.key) ? [`${l.vis.short}: ${this.stage.layerProblem(l.key)}`] : []),
    ]);
    if (this.failure) problems.unshift(this.failure);
    const quiet = this.layers.length && this.layers.every((l) => !l.frame);
    const more = problems.length > 4 ? [`and ${problems.length - 4} more`] : [];
    const text =
      [...problems.slice(0, 4), ...more].join("\n") ||
      (quiet ? "nothing at the cursor" : (this.stage?.describeCounts() ?? ""));
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", problems.length > 0);
  }

  cursorMoved() {}

  themeChanged() {
    for (const l of this.layers) this.putLayer(l);
    this.app.scheduleDraw(this);
  }

  destroy() {
    this.gone = true;
    this.observer.disconnect();
    showTip(this, []);
    for (const l of this.layers) this.closeLayer(l);
    this.stage?.close();
  }
}
