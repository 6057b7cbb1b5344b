// A list of the messages around the cursor; a click moves the cursor to one. Lines of logs have a level and a name, and
// are selected by level and text. The server searches, so that lines far away from the cursor are found.

import { KIND } from "../data/frames.js";
import { formatClock } from "../time/clock.js";

const LEVELS = ["", "debug", "info", "warning", "error", "fatal"];
// Typing is sent to the server after this many ms.
const PAUSE = 250;

export class LogPanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("log-cell");
    this.addFilter();
    this.list = el.appendChild(document.createElement("ol"));
    this.list.tabIndex = 0;
    this.list.addEventListener("click", (e) => this.goToRow([...this.list.children].indexOf(e.target.closest("li"))));
    this.list.addEventListener("keydown", (e) => this.handleKey(e));
    this.configure(config);
  }

  addFilter() {
    const bar = this.el.appendChild(document.createElement("div"));
    bar.className = "log-filter";
    this.level = bar.appendChild(document.createElement("select"));
    this.level.setAttribute("aria-label", "Levels");
    LEVELS.forEach((name, i) => {
      const option = this.level.appendChild(document.createElement("option"));
      option.value = String(i);
      option.textContent = i === 0 ? "all levels" : i === LEVELS.length - 1 ? name : `${name} and above`;
    });
    this.words = bar.appendChild(document.createElement("input"));
    Object.assign(this.words, { type: "search", placeholder: "Filter by text", maxLength: 40 });
    this.words.setAttribute("aria-label", "Filter by text");
    this.level.addEventListener("change", () => this.setProperty("level", this.level.value));
    this.words.addEventListener("input", () => {
      clearTimeout(this.typing);
      this.typing = setTimeout(() => this.setProperty("words", this.words.value), PAUSE);
    });
  }

  // Sets a property of the stream, which the layout stores.
  setProperty(name, value) {
    const panel = this.el.closest("[data-panel]")?.dataset.panel;
    this.app.options.push?.("prop", { panel, index: "0", props: { [name]: value }, _target: ["props", name] });
  }

  configure(config) {
    const vis = config.vis[0];
    this.level.value = vis?.props?.level ?? "0";
    if (document.activeElement !== this.words) this.words.value = vis?.props?.words ?? "";
    const key = vis ? JSON.stringify([vis.stream, vis.path, vis.asked]) : "";
    if (key === this.key) return;
    this.key = key;
    this.app.client.closeChannel(this.channel);
    this.rows = [];
    this.list.setAttribute("aria-label", `Messages of ${vis?.name ?? "nothing"}`);
    const spec = vis && { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    this.channel = vis ? this.app.client.openChannel(spec, (f) => this.acceptFrame(f), { instant: true }) : null;
  }

  acceptFrame(f) {
    const list = f.kind === KIND.json ? f.value : { rows: [], at: -1 };
    this.rows = list.rows.map(([t, ...texts]) => [this.app.client.toRelative(BigInt(t)), ...texts]);
    this.at = list.at;
    this.notice =
      f.kind === KIND.error
        ? f.message
        : f.kind === KIND.none
          ? "no message up to the cursor"
          : list.searched
            ? `Searched ${list.searched.toLocaleString("en")} messages on each side of the cursor.`
            : list.rows.length
              ? null
              : "No message passes the filter.";
    this.app.scheduleDraw(this);
  }

  render() {
    const { origin } = this.app.client;
    const rows = this.notice ? [...this.rows, [null, this.notice, 0, ""]] : this.rows;
    while (this.list.children.length > rows.length) this.list.lastChild.remove();
    rows.forEach(([t, text, level, name], i) => {
      const li = this.list.children[i] ?? this.addRow();
      const texts = [t === null ? "" : formatClock(t, origin), LEVELS[level], name, text];
      texts.forEach((cell, j) => {
        if (li.children[j].textContent !== cell) li.children[j].textContent = cell;
      });
      li.dataset.level = LEVELS[level];
      li.toggleAttribute("aria-current", i === this.at);
    });
    // scrolls only the list
    const now = this.list.children[this.at];
    if (now) this.list.scrollTop = now.offsetTop - this.list.clientHeight / 2;
  }

  addRow() {
    const li = this.list.appendChild(document.createElement("li"));
    for (const c of ["t", "l", "n", "v"]) li.appendChild(document.createElement("span")).className = c;
    return li;
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
    clearTimeout(this.typing);
    this.app.client.closeChannel(this.channel);
  }
}
