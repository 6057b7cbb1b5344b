// A panel that is drawn by a plug-in: on its canvas, or with its own elements.

import { PluginDrawer } from "../plugins/plugin_drawer.js";
import { KIND } from "../data/frames.js";
import { showTip } from "../page/tip.js";

export class PluginPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("own-cell");
    const addChild = (tag, name) => {
      const child = el.appendChild(document.createElement(tag));
      child.className = name;
      return child;
    };
    this.canvas = addChild("canvas", "own-canvas");
    this.body = addChild("div", "own-body");
    this.info = addChild("div", "cell-info");
    this.observer = new ResizeObserver(() => app.scheduleDraw(this));
    this.observer.observe(el);
    el.addEventListener("pointermove", (e) => this.showTipAt(e));
    el.addEventListener("pointerleave", () => showTip(this, []));
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.viz, vis.stream, vis.path, vis.asked, vis.script?.url]) : "";
    this.vis = vis;
    if (this.plug) this.plug.vis = vis;
    this.app.scheduleDraw(this);
    if (key === this.key) return;
    this.closePlugin();
    this.key = key;
    if (!vis) return;
    if (vis.script) this.plug = new PluginDrawer(vis, () => this.app.scheduleDraw(this), this.body);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    this.channel = this.app.client.openChannel(spec, (frame) => this.acceptFrame(frame), { instant: true });
  }

  acceptFrame(frame) {
    this.refused = frame.kind === KIND.error ? frame.message : null;
    this.at = frame.at;
    this.plug?.acceptFrame(frame);
    this.app.scheduleDraw(this);
  }

  render() {
    const width = this.el.clientWidth,
      height = this.el.clientHeight;
    if (!width || !height) return;
    const { canvas } = this;
    const w = Math.round(width * devicePixelRatio),
      h = Math.round(height * devicePixelRatio);
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const ctx = canvas.getContext("2d");
    ctx.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    ctx.clearRect(0, 0, width, height);
    if (this.vis?.props?.visible !== false) this.plug?.draw(ctx, { width, height });
    const problem =
      this.plug?.errorText() ?? this.refused ?? (this.vis && !this.vis.script ? this.missingPlugin() : null);
    this.info.textContent = problem ?? "";
    this.info.classList.toggle("bad", problem != null);
    if (this.at != null) canvas.dataset.at = String(this.at);
  }

  missingPlugin() {
    return `no plug-in draws ${this.vis.viz}: is it installed?`;
  }

  showTipAt(e) {
    const box = this.el.getBoundingClientRect();
    showTip(this, this.plug?.describeAt(e.clientX - box.left, e.clientY - box.top, 1) ?? [], e.clientX, e.clientY);
  }

  cursorMoved() {}

  themeChanged() {
    this.app.scheduleDraw(this);
  }

  closePlugin() {
    this.app.client.closeChannel(this.channel);
    this.plug?.close();
    this.plug = this.refused = null;
    this.body.textContent = "";
  }

  destroy() {
    this.observer.disconnect();
    showTip(this, []);
    this.closePlugin();
  }
}
