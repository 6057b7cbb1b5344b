// Draws the pipeline graph as SVG. The layout changes only with the graph's shape; numbers and colors are updated in
// place.
import { layoutGraph, smoothPath } from "./layout.js";

const NS = "http://www.w3.org/2000/svg";

export class PipelineGraph {
  constructor(el, { onPick, onFold }) {
    this.el = el;
    this.onPick = onPick;
    this.onFold = onFold;
    this.svg = this.addElement("svg", el);
    const defs = this.addElement("defs", this.svg);
    const marker = this.addElement("marker", defs, {
      id: "arrow",
      viewBox: "0 0 8 8",
      refX: 7,
      refY: 4,
      markerWidth: 7,
      markerHeight: 7,
      orient: "auto-start-reverse",
      markerUnits: "userSpaceOnUse",
    });
    this.addElement("path", marker, { d: "M0 0.5 L7.5 4 L0 7.5z", class: "arrow" });
    this.world = this.addElement("g", this.svg);
    this.view = { x: 0, y: 0, k: 1 };
    this.items = new Map();
    this.addListeners();
    this.resized = new ResizeObserver(() => this.moved || this.fitView());
    this.resized.observe(el);
  }

  addElement(name, parent, attributes = {}, text) {
    const el = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes))
      if (value !== undefined && value !== null) el.setAttribute(key, value);
    if (text !== undefined) el.textContent = text;
    parent.appendChild(el);
    return el;
  }

  setGraph(graph) {
    const first = this.items.size === 0;
    const places = layoutGraph(graph);
    this.size = places;
    this.world.textContent = "";
    this.items.clear();
    // outer boxes are below inner ones
    const boxDepth = (b) => (b.parent ? 1 + boxDepth(graph.boxes.find((o) => o.key === b.parent) ?? {}) : 0);
    for (const b of [...graph.boxes].sort((a, c) => boxDepth(a) - boxDepth(c)))
      this.drawBox(b, places.boxes.get(b.key));
    for (const e of graph.edges) this.drawEdge(e, places.edges.get(e.key));
    for (const n of graph.nodes) this.drawNode(n, places.nodes.get(n.key));
    if (first || !this.moved) this.fitView();
    if (this.last) this.setStats(this.last);
  }

  drawBox(box, place) {
    if (!place) return;
    const g = this.addElement("g", this.world, { class: "box", "data-key": box.key, "data-path": box.path });
    this.addElement("rect", g, { ...roundRect(place), rx: 10 });
    const title = this.addElement("g", g, { class: "fold", transform: `translate(${place.x + 10} ${place.y + 16})` });
    this.addElement("text", title, { class: "box-label" }, `▾ ${box.label}`);
    this.items.set(box.key, { g });
  }

  drawNode(node, place) {
    const g = this.addElement("g", this.world, {
      class: `node ${node.kind}${node.joins ? " joins" : ""}`,
      "data-key": node.key,
      "data-path": node.path,
      transform: `translate(${place.x} ${place.y})`,
    });
    this.addElement("title", g, {}, node.path);
    const round = node.kind === "operator" || node.kind === "tap" ? place.height / 2 : 7;
    const rect = this.addElement("rect", g, { width: place.width, height: place.height, rx: round });
    const mark = { source: "●", composite: "▸", tap: "◌" }[node.kind] ?? (node.joins ? "+" : "");
    if (mark) this.addElement("text", g, { class: "mark", x: 14, y: place.height / 2 + 4 }, mark);
    const x = mark ? place.width / 2 + 8 : place.width / 2;
    const label = this.addElement(
      "text",
      g,
      { class: "label", x, y: place.height / 2 + 4 },
      shortenText(node.label, place.width - (mark ? 34 : 18)),
    );
    const sub = this.addElement("text", g, { class: "sub", x, y: place.height - 6 });
    const badge = this.addElement("text", g, { class: "badge", x: place.width - 4, y: -3 });
    this.items.set(node.key, { g, rect, label, sub, badge, height: place.height });
  }

  drawEdge(edge, place) {
    if (!place) return;
    const kind = `edge${edge.lossy ? " lossy" : ""}${edge.inline ? " inline" : ""}`;
    const g = this.addElement("g", this.world, { class: kind, "data-key": edge.key });
    const d = smoothPath(place.points);
    this.addElement("title", g, {}, `${edge.label} [${edge.policy}]`);
    this.addElement("path", g, { class: "hit", d });
    const line = this.addElement("path", g, { class: "line", d, "marker-end": "url(#arrow)" });
    const at = place.x === undefined ? place.points[Math.floor(place.points.length / 2)] : place;
    const policy = edge.policy === "unlimited" ? "" : edge.policy;
    const text = this.addElement("text", g, { class: "number", x: at.x, y: at.y - 5 });
    this.addElement("text", g, { class: "policy", x: at.x, y: at.y + 13 }, policy);
    this.items.set(edge.key, { g, line, text });
  }

  setStats(stats) {
    this.last = stats;
    for (const [key, s] of Object.entries(stats.edges)) {
      const item = this.items.get(key);
      if (!item?.text) continue;
      item.text.textContent = s.text;
      item.g.style.setProperty("--heat", s.heat);
      item.g.classList.toggle("throttled", s.throttled);
      item.g.classList.toggle("faded", s.faded);
    }
    for (const [key, s] of Object.entries(stats.nodes)) {
      const item = this.items.get(key);
      // the numbers may be older than a fold, which turns a component into a box
      if (!item?.sub) continue;
      item.g.style.setProperty("--heat", s.heat);
      item.sub.textContent = s.text;
      item.label.setAttribute("y", item.height / 2 + (s.text ? -1 : 4));
      item.badge.textContent = s.errors ? `${s.errors} ✕` : "";
      item.g.dataset.state = s.state;
    }
    for (const [key, item] of this.items) item.g.classList.toggle("picked", key === stats.selected);
  }

  // Dragging moves the graph, the wheel zooms about the pointer.
  addListeners() {
    /** @type {{x: number, y: number, from: {x: number, y: number, k: number}, far: boolean} | null} */
    let drag = null;
    this.svg.addEventListener("pointerdown", (e) => {
      drag = { x: e.clientX, y: e.clientY, from: { ...this.view }, far: false };
    });
    this.svg.addEventListener("pointermove", (e) => {
      if (!drag) return;
      const dx = e.clientX - drag.x,
        dy = e.clientY - drag.y;
      if (!drag.far && Math.hypot(dx, dy) < 4) return;
      if (!drag.far) this.svg.setPointerCapture(e.pointerId);
      drag.far = true;
      this.setView({ ...drag.from, x: drag.from.x + dx, y: drag.from.y + dy });
    });
    this.svg.addEventListener("pointerup", (e) => {
      const far = drag?.far;
      drag = null;
      if (far) return;
      const key = e.target.closest("[data-key]")?.dataset.key;
      const fold = e.target.closest(".fold")?.parentNode.dataset.path;
      if (fold) this.onFold(fold);
      else this.onPick(key ?? null);
    });
    this.svg.addEventListener("dblclick", (e) => {
      const at = e.target.closest(".node.composite, .box");
      if (at) this.onFold(at.dataset.path);
    });
    this.el.addEventListener(
      "wheel",
      (e) => {
        e.preventDefault();
        const box = this.el.getBoundingClientRect();
        this.zoomBy(Math.exp(-e.deltaY * 0.0015), e.clientX - box.left, e.clientY - box.top);
      },
      { passive: false },
    );
    this.el.addEventListener("keydown", (e) => {
      const w = this.el.clientWidth / 2,
        h = this.el.clientHeight / 2;
      const pan = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[e.key];
      if (pan) this.setView({ ...this.view, x: this.view.x + pan[0], y: this.view.y + pan[1] });
      else if (e.key === "+" || e.key === "=") this.zoomBy(1.25, w, h);
      else if (e.key === "-") this.zoomBy(0.8, w, h);
      else if (e.key === "f") this.fitView();
      else if (e.key === "Tab" || e.key.length !== 1) return;
      else return;
      e.preventDefault();
    });
  }

  zoomBy(by, x, y) {
    const k = Math.min(4, Math.max(0.1, this.view.k * by));
    const r = k / this.view.k;
    this.setView({ k, x: x - (x - this.view.x) * r, y: y - (y - this.view.y) * r });
  }

  setView(view, moved = true) {
    this.view = view;
    this.moved = moved;
    this.world.setAttribute("transform", `translate(${view.x} ${view.y}) scale(${view.k})`);
  }

  fitView() {
    if (!this.size?.width) return;
    const { clientWidth: w, clientHeight: h } = this.el;
    const k = Math.min(1.35, w / this.size.width, h / this.size.height);
    this.setView({ k, x: (w - this.size.width * k) / 2, y: (h - this.size.height * k) / 2 }, false);
  }

  destroy() {
    this.resized.disconnect();
  }
}

const roundRect = ({ x, y, width, height }) => ({
  x: Math.round(x),
  y: Math.round(y),
  width: Math.round(width),
  height: Math.round(height),
});

function shortenText(text, width) {
  const most = Math.max(4, Math.floor(width / 6.4));
  return text.length <= most ? text : `${text.slice(0, most - 1)}…`;
}
