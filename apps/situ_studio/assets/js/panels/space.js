// A 3D panel: the objects of streams in space, from any point of view. The drawing code is loaded with the first
// panel.

import { KIND } from "../data/wire.js";
import { tip } from "../page/tip.js";
import { seriesColor, theme } from "../page/theme.js";

const HERE = document.currentScript?.src ?? location.href;
let drawing = null;
const load = () => (drawing ??= import(new URL("space.js", HERE).href));

// The properties that change what the server sends.
const ASKED = [
  ...["depth_as", "sparsity", "focal", "budget", "axis", "ray", "threshold", "seconds"],
  ...["text_as", "text_height"],
];

// The viewer rests when nothing has moved for so long, ms.
const REST = 250;

const TOOLS = [
  ["fit", "Fit", "See everything"],
  ["top", "Top", "From above"],
  ["fly", "Fly", "Look around by dragging; w a s d to move, q e down and up"],
  ["follow", "Follow", "Stay with what was clicked last"],
  ["measure", "Measure", "Click two places for their distance"],
];

export class SpacePanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    this.layers = [];
    this.show();
    this.configure(config);
    this.observer = new ResizeObserver(() => this.app.schedule(this));
    this.observer.observe(el);
    load().then(
      (space) => this.open(space),
      (error) => this.broken(`the 3D view could not be loaded: ${error.message}`),
    );
  }

  show() {
    this.el.classList.add("space-cell");
    const add = (tag, name) => {
      const child = this.el.appendChild(document.createElement(tag));
      child.className = name;
      return child;
    };
    this.canvas = add("canvas", "space-canvas");
    this.canvas.tabIndex = 0;
    this.info = add("div", "cell-info");
    const bar = add("div", "space-tools");
    bar.setAttribute("role", "toolbar");
    for (const [name, text, title] of TOOLS) {
      const button = bar.appendChild(document.createElement("button"));
      Object.assign(button, { type: "button", className: "space-tool", textContent: text, title });
      button.dataset.tool = name;
    }
    bar.addEventListener("click", (e) => this.use(e.target.closest("button")));
  }

  open(space) {
    if (this.gone) return;
    try {
      this.stage = space.openStage(this.canvas, {
        changed: () => this.app.schedule(this),
        pointed: (lines, x, y) => tip(this, lines, x, y),
        theme,
      });
    } catch (error) {
      return this.broken(error.message);
    }
    for (const layer of this.layers) this.put(layer);
    this.app.schedule(this);
  }

  broken(text) {
    this.failure = text;
    this.app.schedule(this);
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
    for (const l of this.layers) this.put(l);
    this.app.schedule(this);
  }

  openLayer(key, vis, props) {
    const layer = { key, vis };
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props };
    layer.channel = this.app.client.open(spec, (frame) => this.accept(layer, frame), { instant: true });
    return layer;
  }

  closeLayer(layer) {
    this.forget(layer);
    this.app.client.close(layer.channel);
    this.stage?.remove(layer.key);
  }

  // Of clouds too large to be drawn whole, the points that are seen from here, asked for when the viewer rests.
  refine(layer) {
    const planes = this.stage.sees(layer.key)?.map((v) => Number(v.toPrecision(7)));
    const seen = planes ? planes.join() : null;
    if (layer.seen === seen) return;
    layer.seen = seen;
    clearTimeout(layer.resting);
    this.app.client.close(layer.near);
    layer.near = null;
    this.stage.alone(layer.key, false);
    if (seen) layer.resting = setTimeout(() => this.detail(layer, planes), REST);
  }

  detail(layer, planes) {
    const { stream, viz, path } = layer.vis;
    const props = { ...layer.channel.spec.props, within: planes };
    const take = (frame, channel) => {
      if (layer.near !== channel || frame.kind !== KIND.scene || frame.at !== layer.frame?.at) return;
      this.stage?.refine(layer.key, frame);
      this.app.schedule(this);
    };
    layer.near = this.app.client.open({ stream, viz, path, props }, take, { instant: true });
  }

  forget(layer) {
    clearTimeout(layer.resting);
    this.app.client.close(layer.near);
    layer.near = layer.seen = null;
    this.stage?.refine(layer.key, null);
  }

  accept(layer, frame) {
    layer.error = frame.kind === KIND.error ? frame.message : null;
    layer.frame = frame.kind === KIND.scene || frame.kind === KIND.json ? frame : null;
    this.put(layer);
    this.app.schedule(this);
  }

  // One layer as the stage takes it. A layer that cannot be drawn shows an error; the others are drawn.
  put(layer) {
    if (!this.stage) return;
    this.forget(layer);
    const { vis, frame, index } = layer;
    const props = { ...vis.props, color: seriesColor(vis.props?.color, vis.color ?? index ?? 0) };
    try {
      const named = { name: vis.name, short: vis.short, props, own: vis.props?.color != null };
      this.stage.put(layer.key, { ...named, frame, changed: layer.drawn !== frame });
      layer.drawn = frame;
      layer.failure = null;
    } catch (error) {
      layer.failure = `${vis.short}: ${error.message}`;
      this.stage.remove(layer.key);
    }
  }

  use(button) {
    if (!button || !this.stage) return;
    const on = this.stage.use(button.dataset.tool);
    for (const b of this.el.querySelectorAll(".space-tool")) {
      const name = b.dataset.tool;
      b.setAttribute("aria-pressed", String(on.includes(name)));
    }
    this.app.schedule(this);
  }

  render() {
    this.note();
    const w = Math.round(this.el.clientWidth * devicePixelRatio),
      h = Math.round(this.el.clientHeight * devicePixelRatio);
    if (!this.stage || !w || !h) return;
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    for (const layer of this.layers) this.refine(layer);
    this.stage.render(devicePixelRatio);
    this.drawn = (this.drawn ?? 0) + 1;
    const at = this.layers.map((l) => l.frame?.at).filter((t) => t != null);
    if (at.length) this.canvas.dataset.at = String(Math.max(...at));
    else delete this.canvas.dataset.at;
  }

  note() {
    const problems = this.layers.flatMap((l) => [
      ...(l.error ? [`${l.vis.short}: ${l.error}`] : []),
      ...(l.failure ? [l.failure] : []),
      ...(l.frame?.problems ?? []).map((p) => `${l.vis.short}: ${p}`),
      ...(this.stage?.problem(l.key) ? [`${l.vis.short}: ${this.stage.problem(l.key)}`] : []),
    ]);
    if (this.failure) problems.unshift(this.failure);
    const quiet = this.layers.length && this.layers.every((l) => !l.frame);
    const more = problems.length > 4 ? [`and ${problems.length - 4} more`] : [];
    const text =
      [...problems.slice(0, 4), ...more].join("\n") || (quiet ? "nothing at the cursor" : (this.stage?.says() ?? ""));
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", problems.length > 0);
  }

  cursorMoved() {}

  themeChanged() {
    for (const l of this.layers) this.put(l);
    this.app.schedule(this);
  }

  destroy() {
    this.gone = true;
    this.observer.disconnect();
    tip(this, []);
    for (const l of this.layers) this.closeLayer(l);
    this.stage?.close();
  }
}
