// The text at the cursor, large.

import { KIND } from "../data/wire.js";

export class TextPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("text-cell");
    this.body = el.appendChild(document.createElement("div"));
    this.body.className = "big-text";
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path]) : "";
    if (key === this.key) return;
    this.key = key;
    this.app.client.close(this.channel);
    this.channel = vis
      ? this.app.client.open({ stream: vis.stream, viz: vis.viz, path: vis.path }, (f) => this.accept(f), {
          instant: true,
        })
      : null;
  }

  accept(f) {
    this.text = f.kind === KIND.json ? f.value.text : f.kind === KIND.error ? f.message : "";
    this.app.schedule(this);
  }

  render() {
    if (this.body.textContent !== this.text) this.body.textContent = this.text ?? "";
  }

  cursorMoved() {}
  themeChanged() {}

  destroy() {
    this.app.client.close(this.channel);
  }
}
