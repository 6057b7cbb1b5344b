// The messages around the cursor as a list; a click goes to one.

import { KIND } from "../data/wire.js";
import { shown } from "../time/clock.js";

export class LogPanel {
  constructor(el, app, config) {
    Object.assign(this, { el, app });
    el.classList.add("log-cell");
    this.list = el.appendChild(document.createElement("ol"));
    this.list.tabIndex = 0;
    this.list.addEventListener("click", (e) => this.go([...this.list.children].indexOf(e.target.closest("li"))));
    this.list.addEventListener("keydown", (e) => this.press(e));
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path]) : "";
    if (key === this.key) return;
    this.key = key;
    this.app.client.close(this.channel);
    this.rows = [];
    this.list.setAttribute("aria-label", `Messages of ${vis?.name ?? "nothing"}`);
    const spec = vis && { stream: vis.stream, viz: vis.viz, path: vis.path };
    this.channel = vis ? this.app.client.open(spec, (f) => this.accept(f), { instant: true }) : null;
  }

  accept(f) {
    const told = f.kind === KIND.json ? f.value : { rows: [], at: -1 };
    this.rows = told.rows.map(([t, text]) => [this.app.client.rel(BigInt(t)), text]);
    this.at = told.at;
    this.error = f.kind === KIND.error ? f.message : f.kind === KIND.none ? "no message up to the cursor" : null;
    this.app.schedule(this);
  }

  render() {
    const { origin } = this.app.client;
    const rows = this.error ? [[null, this.error]] : this.rows;
    while (this.list.children.length > rows.length) this.list.lastChild.remove();
    rows.forEach(([t, text], i) => {
      const li = this.list.children[i] ?? this.list.appendChild(document.createElement("li"));
      if (!li.children.length)
        for (const c of ["t", "v"]) li.appendChild(document.createElement("span")).className = c;
      const when = t === null ? "" : shown(t, origin);
      if (li.children[0].textContent !== when) li.children[0].textContent = when;
      if (li.children[1].textContent !== text) li.children[1].textContent = text;
      li.toggleAttribute("aria-current", i === this.at);
    });
    // in sight, without scrolling anything else
    const now = this.list.children[this.at];
    if (now) this.list.scrollTop = now.offsetTop - this.list.clientHeight / 2;
  }

  go(i) {
    const row = this.rows[i];
    if (!row) return;
    // the next key counts from here, whether the server has answered by then or not
    this.at = i;
    this.app.schedule(this);
    this.app.time.dispatch({ type: "nudge", by: row[0] - this.app.time.get().cursor });
  }

  press(e) {
    const by = { ArrowDown: 1, ArrowUp: -1 }[e.key];
    if (!by) return;
    this.go(this.at + by);
    e.preventDefault();
    e.stopPropagation();
  }

  cursorMoved() {}

  themeChanged() {}

  destroy() {
    this.app.client.close(this.channel);
  }
}
