// Shows the text at the cursor in large letters.

import { KIND } from "../data/frames.js";
import { formatDuration } from "../time/text.js";

const OLD = 1e9;

export class TextPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("text-cell");
    this.body = el.appendChild(document.createElement("div"));
    this.body.className = "big-text";
    this.age = el.appendChild(document.createElement("div"));
    this.age.className = "cell-info";
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path, vis.asked]) : "";
    if (key === this.key) return;
    this.key = key;
    this.app.client.closeChannel(this.channel);
    this.channel = vis
      ? this.app.client.openChannel(
          { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} },
          (f) => this.acceptFrame(f),
          { instant: true },
        )
      : null;
  }

  acceptFrame(f) {
    this.text = f.kind === KIND.json ? f.value.text : f.kind === KIND.error ? f.message : "";
    this.at = f.kind === KIND.json ? f.at : null;
    this.app.scheduleDraw(this);
  }

  render() {
    if (this.body.textContent !== this.text) this.body.textContent = this.text ?? "";
    this.cursorMoved();
  }

  // Shows the age of the text.
  cursorMoved() {
    const age = this.at == null ? 0 : this.app.time.get().cursor - this.at;
    const text = age >= OLD ? `${formatDuration(age)} ago` : "";
    if (this.age.textContent !== text) this.age.textContent = text;
  }
  themeChanged() {}

  destroy() {
    this.app.client.closeChannel(this.channel);
  }
}
