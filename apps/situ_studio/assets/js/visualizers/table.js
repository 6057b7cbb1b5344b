// A table of the exact values of several streams at the cursor, with the values before and after. Its values are the
// server's texts, so nothing is rounded.

import { KIND } from "../data/frames.js";
import { formatClock } from "../time/clock.js";
import { copyText } from "../page/toast.js";
import { csvLine } from "../page/csv.js";

const HEAD = ["Stream", "Before", "At the cursor", "Time", "After"];

export class TablePanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("table-cell");
    const scroller = el.appendChild(document.createElement("div"));
    scroller.className = "table-scroller";
    scroller.tabIndex = 0;
    this.table = scroller.appendChild(document.createElement("table"));
    const head = this.table.createTHead().insertRow();
    for (const text of HEAD) {
      const th = head.appendChild(document.createElement("th"));
      th.scope = "col";
      th.textContent = text;
    }
    this.body = this.table.createTBody();
    const copy = el.appendChild(document.createElement("button"));
    copy.className = "copy-table";
    copy.type = "button";
    copy.textContent = "Copy as CSV";
    copy.addEventListener("click", () => this.copyValues());
    /** @type {Map<string, {channel: any, frame: any}>} the streams by their channel's specification */
    this.open = new Map();
    this.configure(config);
  }

  configure(config) {
    this.vis = config.vis;
    const keys = this.vis.map(specKey);
    for (const [key, { channel }] of this.open) {
      if (keys.includes(key)) continue;
      this.app.client.closeChannel(channel);
      this.open.delete(key);
    }
    this.vis.forEach((vis, i) => this.openStream(vis, keys[i]));
    this.app.scheduleDraw(this);
  }

  openStream(vis, key) {
    if (this.open.has(key)) return;
    const entry = { channel: null, frame: null };
    this.open.set(key, entry);
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    const accept = (f) => {
      entry.frame = f;
      this.app.scheduleDraw(this);
    };
    entry.channel = this.app.client.openChannel(spec, accept, { instant: true });
  }

  // Returns the texts of a stream's row.
  rowTexts(vis) {
    const f = this.open.get(specKey(vis))?.frame;
    if (f?.kind === KIND.error) return [vis.name, "", f.message, "", ""];
    if (f?.kind !== KIND.json) return [vis.name, "", f ? "no message at the cursor" : "", "", ""];
    const { before, now, after } = f.value;
    return [vis.name, before?.[1] ?? "", now[1], this.clock(now[0]), after?.[1] ?? ""];
  }

  clock(time) {
    return formatClock(this.app.client.toRelative(BigInt(time)), this.app.client.origin);
  }

  render() {
    while (this.body.rows.length > this.vis.length) this.body.deleteRow(-1);
    this.vis.forEach((vis, i) => {
      const row = this.body.rows[i] ?? this.addRow();
      this.rowTexts(vis).forEach((text, j) => {
        if (row.cells[j].textContent !== text) row.cells[j].textContent = text;
      });
    });
  }

  addRow() {
    const row = this.body.insertRow();
    for (let j = 0; j < HEAD.length; j++) {
      const cell = row.appendChild(document.createElement(j === 0 ? "th" : "td"));
      if (j === 0) /** @type {HTMLTableCellElement} */ (cell).scope = "row";
    }
    return row;
  }

  // Copies the stream, the exact time in nanoseconds, and the value at the cursor of every row.
  copyValues() {
    const lines = this.vis.flatMap((vis) => {
      const f = this.open.get(specKey(vis))?.frame;
      return f?.kind === KIND.json ? [csvLine([vis.name, ...f.value.now])] : [];
    });
    copyText([csvLine(["stream", "time_ns", "value"]), ...lines].join(""), "Values copied");
  }

  cursorMoved() {}

  themeChanged() {}

  destroy() {
    for (const { channel } of this.open.values()) this.app.client.closeChannel(channel);
  }
}

const specKey = (vis) => JSON.stringify([vis.stream, vis.path, vis.asked]);
