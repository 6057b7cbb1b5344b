// A panel that a plug-in fills: its canvas, or its own elements.

import { Plugged } from "../plugins/plugged.js";
import { KIND } from "../data/wire.js";
import { tip } from "../page/tip.js";

export class OwnPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("own-cell");
    const add = (tag, name) => {
      const child = el.appendChild(document.createElement(tag));
      child.className = name;
      return child;
    };
    this.canvas = add("canvas", "own-canvas");
    this.body = add("div", "own-body");
    this.info = add("div", "cell-info");
    this.observer = new ResizeObserver(() => app.schedule(this));
    this.observer.observe(el);
    el.addEventListener("pointermove", (e) => this.point(e));
    el.addEventListener("pointerleave", () => tip(this, []));
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.viz, vis.stream, vis.path, vis.asked, vis.script?.url]) : "";
    this.vis = vis;
    if (this.plug) this.plug.vis = vis;
    this.app.schedule(this);
    if (key === this.key) return;
    this.close();
    this.key = key;
    if (!vis) return;
    if (vis.script) this.plug = new Plugged(vis, () => this.app.schedule(this), this.body);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    this.channel = this.app.client.open(spec, (frame) => this.accept(frame), { instant: true });
  }

  accept(frame) {
    this.refused = frame.kind === KIND.error ? frame.message : null;
    this.at = frame.at;
    this.plug?.accept(frame);
    this.app.schedule(this);
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
    const problem = this.plug?.problem() ?? this.refused ?? (this.vis && !this.vis.script ? this.nobody() : null);
    this.info.textContent = problem ?? "";
    this.info.classList.toggle("bad", problem != null);
    if (this.at != null) canvas.dataset.at = String(this.at);
  }

  nobody() {
    return `nothing here draws ${this.vis.viz}: is its plug-in there?`;
  }

  point(e) {
    const box = this.el.getBoundingClientRect();
    tip(this, this.plug?.under(e.clientX - box.left, e.clientY - box.top, 1) ?? [], e.clientX, e.clientY);
  }

  cursorMoved() {}

  themeChanged() {
    this.app.schedule(this);
  }

  close() {
    this.app.client.close(this.channel);
    this.plug?.close();
    this.plug = this.refused = null;
    this.body.textContent = "";
  }

  destroy() {
    this.observer.disconnect();
    tip(this, []);
    this.close();
  }
}
