// A list of the messages around the cursor; a click moves the cursor to one.

import { KIND } from "../data/frames.js";
import { formatClock } from "../time/clock.js";

export class LogPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("log-cell");
    this.list = el.appendChild(document.createElement("ol"));
    this.list.tabIndex = 0;
    this.list.addEventListener("click", (e) => this.goToRow([...this.list.children].indexOf(e.target.closest("li"))));
    this.list.addEventListener("keydown", (e) => this.handleKey(e));
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path]) : "";
    if (key === this.key) return;
    this.key = key;
    this.app.client.closeChannel(this.channel);
    this.rows = [];
    this.list.setAttribute("aria-label", `Messages of ${vis?.name ?? "nothing"}`);
    const spec = vis && { stream: vis.stream, viz: vis.viz, path: vis.path };
    this.channel = vis ? this.app.client.openChannel(spec, (f) => this.acceptFrame(f), { instant: true }) : null;
  }

  acceptFrame(f) {
    const list = f.kind === KIND.json ? f.value : { rows: [], at: -1 };
    this.rows = list.rows.map(([t, text]) => [this.app.client.toRelative(BigInt(t)), text]);
    this.at = list.at;
    this.error = f.kind === KIND.error ? f.message : f.kind === KIND.none ? "no message up to the cursor" : null;
    this.app.scheduleDraw(this);
  }

  render() {
    const { origin } = this.app.client;
    const rows = this.error ? [[null, this.error]] : this.rows;
    while (this.list.children.length > rows.length) this.list.lastChild.remove();
    rows.forEach(([t, text], i) => {
      const li = this.list.children[i] ?? this.list.appendChild(document.createElement("li"));
      if (!li.children.length)
        for (const c of ["t", "v"]) li.appendChild(document.createElement("span")).className = c;
      const when = t === null ? "" : formatClock(t, origin);
      if (li.children[0].textContent !== when) li.children[0].textContent = when;
      if (li.children[1].textContent !== text) li.children[1].textContent = text;
      li.toggleAttribute("aria-current", i === this.at);
    });
    // scrolls only the list
    const now = this.list.children[this.at];
    if (now) this.list.scrollTop = now.offsetTop - this.list.clientHeight / 2;
  }

  goToRow(i) {
    const row = this.rows[i];
    if (!row) return;
    // the next key counts from here, even if the server has not replied yet
    this.at = i;
    this.app.scheduleDraw(this);
    this.app.time.dispatch({ type: "nudge", by: row[0] - this.app.time.get().cursor });
  }

  handleKey(e) {
    const by = { ArrowDown: 1, ArrowUp: -1 }[e.key];
    if (!by) return;
    this.goToRow(this.at + by);
    e.preventDefault();
    e.stopPropagation();
  }

  cursorMoved() {}

  themeChanged() {}

  destroy() {
    this.app.client.closeChannel(this.channel);
  }
}
