// Shows any message as a tree that marks the differences to the message before it and can plot its numbers. Nodes are
// [kind, text, children] and children [key, node, path]; texts are only set as textContent.

import { KIND } from "../data/frames.js";
import { formatClock } from "../time/clock.js";
import { formatLatency } from "../time/text.js";
import { copyText } from "../page/toast.js";

export class ValuePanel {
  constructor(el, app, config) {
    this.el = el;
    this.app = app;
    el.classList.add("value-cell");
    this.head = el.appendChild(document.createElement("div"));
    this.head.className = "value-head";
    this.body = el.appendChild(document.createElement("div"));
    this.body.className = "value-tree";
    this.body.setAttribute("role", "tree");
    this.closed = new Set();
    this.rows = new Map();
    this.body.addEventListener("click", (e) => this.handleClick(e));
    this.body.tabIndex = 0;
    this.body.addEventListener("keydown", (e) => this.handleKey(e));
    this.configure(config);
  }

  configure(config) {
    const vis = config.vis[0];
    const key = vis ? JSON.stringify([vis.stream, vis.path, vis.asked]) : "";
    this.vis = vis;
    if (key === this.key) return;
    this.key = key;
    this.app.client.closeChannel(this.channel);
    this.channel = null;
    this.value = null;
    if (!vis) return;
    const spec = { stream: vis.stream, viz: vis.viz, path: vis.path, props: vis.asked ?? {} };
    this.channel = this.app.client.openChannel(spec, (f) => this.acceptFrame(f), { instant: true });
  }

  acceptFrame(f) {
    this.message = f.kind === KIND.error ? f.message : f.kind === KIND.none ? "no message at the cursor" : null;
    this.value = f.kind === KIND.json ? f.value : null;
    this.app.scheduleDraw(this);
  }

  render() {
    const v = this.value;
    if (!v) {
      this.head.textContent = this.message ?? "";
      this.body.textContent = "";
      return;
    }
    const origin = this.app.client.origin ?? 0n;
    const rel = Number(BigInt(v.time) - origin);
    const at = formatClock(rel, this.app.client.origin);
    const changes = v.was ? Object.keys(v.was).length + v.gone.length : 0;
    const different = v.was
      ? `   ${changes || "no"} difference${changes === 1 ? "" : "s"} to the message before`
      : "";
    this.head.textContent = `#${v.sequence}   ${at}   latency ${formatLatency(v.latency)}   ${v.type}${different}`;
    const lines = [];
    this.collectLines(v.tree, "value", "", 0, lines);
    for (const [path, text] of v.gone ?? [])
      lines.push({ kind: "gone", text: "", key: path, path: null, depth: 1, parent: false, was: text });
    this.showLines(lines);
  }

  collectLines(node, key, path, depth, out) {
    const [kind, text, children] = node;
    const open = children && !this.closed.has(path || "/");
    out.push({ kind, text, key, path, depth, parent: !!children, open });
    if (open) for (const [k, child, p] of children) this.collectLines(child, k, p, depth + 1, out);
  }

  showLines(lines) {
    const body = this.body;
    while (body.children.length > lines.length) body.lastChild.remove();
    const was = this.value.was ?? {};
    lines.forEach((l, i) => {
      let row = body.children[i];
      if (!row) row = body.appendChild(makeRow());
      row.dataset.path = l.path ?? "";
      row.dataset.kind = l.kind;
      row.style.paddingLeft = `${8 + l.depth * 14}px`;
      row.children[0].textContent = l.parent ? (l.open ? "▾" : "▸") : "";
      row.children[1].textContent = l.key;
      if (row.children[2].textContent !== l.text) row.children[2].textContent = l.text;
      row.children[2].className = `v ${l.kind}`;
      const changed = l.path !== null && !l.parent && Object.hasOwn(was, l.path);
      row.classList.toggle("changed", changed);
      row.classList.toggle("gone", l.kind === "gone");
      row.children[3].textContent = l.kind === "gone" ? l.was : changed ? (was[l.path] ?? "new") : "";
      const plot = l.path !== null && ["number", "boolean", "atom", "string"].includes(l.kind);
      row.querySelector(".plot-path").hidden = !plot;
      row.querySelector(".copy-path").hidden = l.path == null;
      row.dataset.parent = l.parent ? "1" : "";
      row.setAttribute("aria-expanded", l.parent ? String(l.open) : "");
    });
  }

  handleClick(e) {
    const row = e.target.closest(".row");
    if (!row) return;
    const path = row.dataset.path;
    if (e.target.closest(".plot-path")) this.app.plotPath(this.vis.stream, path, row.dataset.kind);
    else if (e.target.closest(".copy-path")) copyText(this.vis.stream + path, "Path copied");
    else if (e.target.closest(".copy-value")) copyText(row.children[2].textContent, "Value copied");
    else this.toggleFold(row);
  }

  toggleFold(row) {
    if (!row.dataset.parent) return;
    const id = row.dataset.path || "/";
    if (!this.closed.delete(id)) this.closed.add(id);
    this.render();
  }

  // Arrow keys move through the tree; Enter folds or plots, c copies the path, v the value.
  handleKey(e) {
    const rows = [...this.body.children];
    const i = rows.indexOf(document.activeElement?.closest(".row"));
    const row = rows[i];
    const open = row?.getAttribute("aria-expanded");
    if (e.key === "ArrowDown") rows[Math.min(i + 1, rows.length - 1)]?.focus();
    else if (e.key === "ArrowUp") rows[Math.max(i - 1, 0)]?.focus();
    else if (row && e.target === row && e.key === "Enter" && row.dataset.parent) this.toggleFold(row);
    else if (row && e.target === row && e.key === "Enter") row.querySelector(".plot-path:not([hidden])")?.click();
    else if (row && e.key === "v" && !e.ctrlKey && !e.altKey) row.querySelector(".copy-value")?.click();
    else if (row && e.key === "c" && !e.ctrlKey) row.querySelector(".copy-path:not([hidden])")?.click();
    else if (open === "false" && e.key === "ArrowRight") this.toggleFold(row);
    else if (open === "true" && e.key === "ArrowLeft") this.toggleFold(row);
    else return;
    e.preventDefault();
    e.stopPropagation();
  }

  cursorMoved() {}
  themeChanged() {}

  destroy() {
    this.app.client.closeChannel(this.channel);
  }
}

function makeRow() {
  const row = document.createElement("div");
  row.className = "row";
  row.setAttribute("role", "treeitem");
  row.tabIndex = -1;
  for (const c of ["fold", "k", "v", "was"]) row.appendChild(document.createElement("span")).className = c;
  const plot = row.appendChild(document.createElement("button"));
  plot.className = "plot-path";
  plot.textContent = "plot";
  plot.title = "Plot this path over time (Enter)";
  const copy = row.appendChild(document.createElement("button"));
  copy.className = "copy-path";
  copy.textContent = "path";
  copy.title = "Copy the path (c)";
  const value = row.appendChild(document.createElement("button"));
  value.className = "copy-value";
  value.textContent = "value";
  value.title = "Copy the value (v)";
  return row;
}
