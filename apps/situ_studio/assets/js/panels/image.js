// A 2D panel: an image, and other streams drawn over it.

import { showTip } from "../page/tip.js";
import { getVisualizer } from "../visualizers/index.js";
import { pluginVisualizer } from "../plugins/plugin_drawer.js";
import { imageMapping } from "../visualizers/shapes.js";
import { VideoLayer } from "../visualizers/video_layer.js";
import { KIND } from "../data/frames.js";
import { PanZoom } from "./pan_zoom.js";

export class ImagePanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("image-cell");
    this.canvas = el.appendChild(document.createElement("canvas"));
    this.info = el.appendChild(document.createElement("div"));
    this.info.className = "cell-info";
    this.layers = [];
    // while boxes or points are annotated they are drawn here; otherwise the image is moved
    this.canvas.addEventListener("pointerdown", (e) => {
      if (this.app.annotation?.spatial.handlePointerDown(e, this)) e.stopImmediatePropagation();
    });
    this.mouse = new PanZoom(this.canvas, {
      fit: () => this.fit(),
      changed: () => this.app.scheduleDraw(this),
      pointed: () => this.updateTip(),
    });
    this.configure(config);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    this.resize();
  }

  configure(config) {
    this.config = config;
    const old = new Map(this.layers.map((l) => [l.key, l]));
    this.layers = config.vis.map((vis, index) => {
      const key = JSON.stringify([vis.viz, vis.stream, vis.path, vis.asked, vis.script?.url]);
      const layer = old.get(key) ?? this.openLayer(key, vis);
      old.delete(key);
      return Object.assign(layer, { vis, index });
    });
    for (const l of old.values()) this.closeLayer(l);
    for (const l of this.layers) l.drawer.restyle(l, () => this.app.scheduleDraw(this));
    this.app.scheduleDraw(this);
  }

  openLayer(key, vis) {
    const drawer = vis.script ? pluginVisualizer : getVisualizer(vis.draw, "image");
    const layer = { key, vis, drawer };
    this.openChannel(layer);
    if (drawer.id === "image" && !vis.path && !this.app.options.offline) layer.video = this.openVideo(layer);
    return layer;
  }

  openChannel(layer) {
    const { vis } = layer;
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    const acceptFrame = (frame) => {
      layer.drawer.acceptFrame(layer, frame, () => this.app.scheduleDraw(this));
      if (frame.kind === KIND.image) layer.video?.begin();
    };
    layer.channel = this.app.client.openChannel(spec, acceptFrame, { instant: true });
  }

  // The page decodes a compressed stream by itself, and then needs no images from the server.
  openVideo(layer) {
    return new VideoLayer(this.app, layer, {
      changed: () => this.app.scheduleDraw(this),
      opened: () => {
        this.app.client.closeChannel(layer.channel);
        layer.channel = null;
        layer.generation = (layer.generation ?? 0) + 1;
      },
      failed: () => this.openChannel(layer),
    });
  }

  closeLayer(l) {
    this.app.client.closeChannel(l.channel);
    l.video?.close();
    l.drawer.close(l);
  }

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.scheduleDraw(this);
  }

  baseLayer() {
    return this.layers.find((l) => l.picture);
  }

  // Returns the canvas pixels per image pixel and the position of the image's corner, after letterboxing and
  // zooming.
  fit() {
    const base = this.baseLayer()?.picture;
    const shapes = this.layers.find((l) => l.shapes?.size)?.shapes.size;
    const classes = this.layers.find((l) => l.masks?.classes)?.masks.classes;
    const width = base?.width ?? shapes?.[0] ?? classes?.width ?? 640,
      height = base?.height ?? shapes?.[1] ?? classes?.height ?? 480;
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    const { zoom } = this.mouse;
    const k = Math.min(w / width, h / height) * zoom.k;
    return { k, x: (w - width * k) / 2 + zoom.x, y: (h - height * k) / 2 + zoom.y, width, height };
  }

  // Shapes over a mirrored image are mirrored, too.
  map() {
    return imageMapping(this.fit(), this.baseLayer()?.vis.props?.flip === true);
  }

  // Draws on the screen, or on another context such as `page/svg_context.js`.
  render(ctx = this.canvas.getContext("2d")) {
    for (const l of this.layers) l.video?.apply();
    const f = this.fit(),
      map = this.map();
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    ctx.imageSmoothingEnabled = f.k < 3;
    const shown = this.layers.filter((l) => l.vis.props?.visible !== false);
    const scene = { fit: f, map, width: w, height: h };
    // images are below everything drawn over them
    for (const l of shown) if (l.picture) l.drawer.draw(ctx, l, scene);
    for (const l of shown) if (!l.picture) l.drawer.draw(ctx, l, scene);
    for (const l of shown) l.drawer.drawOverlay?.(ctx, l, scene);
    this.app.annotation?.spatial.draw(ctx, this);
    this.updateTip();
    this.drawn = (this.drawn ?? 0) + 1;
    const base = this.baseLayer();
    // not on the panel's element, since a diff would remove it there
    if (base) this.canvas.dataset.at = String(base.at);
    else delete this.canvas.dataset.at;
  }

  // Shows the value under the mouse next to it, and the image's size, age and value in the corner.
  updateTip() {
    const size = this.fit();
    for (const l of this.layers) l.size = size;
    const at = this.mouse.pointer && this.map().back(...this.mouse.pointer);
    this.updateNote(at);
    const { k } = size;
    const found = at
      ? this.layers.flatMap((l) => (l.vis.props?.visible !== false ? l.drawer.describeAt(l, ...at, k) : []))
      : [];
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = this.mouse.pointer ?? [0, 0];
    showTip(this, found, box.left + x, box.top + y);
  }

  updateNote(at) {
    const error = this.layers.find((l) => l.error)?.error;
    const base = this.baseLayer();
    let text = error ?? "";
    if (!error && base) text = [...base.drawer.imageFacts(base, this.app.time.get().cursor, at)].join("   ");
    else if (!error && this.layers.length)
      text = this.layers.some((l) => l.shapes || l.masks) ? "" : "no image at the cursor";
    if (text !== this.text) this.info.textContent = this.text = text;
    this.info.classList.toggle("bad", !!error);
  }

  cursorMoved() {
    for (const l of this.layers) l.video?.update();
    this.updateTip();
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.observer.disconnect();
    showTip(this, []);
    for (const l of this.layers) this.closeLayer(l);
  }
}
