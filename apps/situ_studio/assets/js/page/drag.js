// Drags streams from the tree to panels, and panels to other places. Panels can also be moved by keys.

import { pushEvent } from "./channel.js";

const STREAM = "application/x-situ-stream";
// The dragged item can only be read on drop; its kind is available all the time.
const PANEL = "application/x-situ-panel";
const WAYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right" };
// What is dropped this close to an edge of a panel, as a share of its size, goes to this side of it.
const EDGE = 0.28;
// What is dropped this close to the edge of all panels, in pixels, goes to this side of all.
const RIM = 14;

// Returns the side of a box that a point is on, by the nearest edge, or `inside` if it is not near an edge.
export function dropSide({ left, top, width, height }, x, y, inside, edge = EDGE) {
  const across = (x - left) / width,
    down = (y - top) / height;
  const far = { left: across, right: 1 - across, above: down, below: 1 - down };
  const [side, least] = Object.entries(far).sort(([, a], [, b]) => a - b)[0];
  return least < edge ? side : inside;
}

// Returns the side of the box of all panels that a point is at, or null.
export function rimSide({ left, top, right, bottom }, x, y) {
  const far = { left: x - left, right: right - x, above: y - top, below: bottom - y };
  const [side, least] = Object.entries(far).sort(([, a], [, b]) => a - b)[0];
  return least < RIM ? side : null;
}

// Returns where something that is dragged would go: {side, target, el}, or null. `inside` is the side in the middle of
// a panel.
function dropTargetAt(stack, e, inside) {
  const rim = rimSide(stack.getBoundingClientRect(), e.clientX, e.clientY);
  if (rim) return { side: rim, target: "all", el: stack };
  const strip = e.target.closest?.(".tab-strip");
  if (strip) return { side: inside, target: strip.parentElement.dataset.part, el: strip.parentElement };
  const box = e.target.closest?.(".panel-box");
  if (!box) return null;
  const side = dropSide(box.getBoundingClientRect(), e.clientX, e.clientY, inside);
  return { side, target: box.dataset.part, el: box };
}

export const hooks = {
  Grip: {
    mounted() {
      this.el.addEventListener("keydown", (e) => {
        const way = WAYS[e.key];
        if (!way || e.altKey || e.ctrlKey || e.metaKey || e.shiftKey) return;
        e.preventDefault();
        e.stopPropagation();
        const { id } = this.el;
        // an element that is moved loses the focus
        pushEvent("shift_panel", { id: this.el.dataset.drag, way }, () =>
          requestAnimationFrame(() => {
            const grip = document.getElementById(id);
            grip?.focus();
            grip?.scrollIntoView({ block: "nearest" });
          }),
        );
      });
    },
  },

  // The names of panels that are one behind the other. Arrow keys show the next one.
  Tabs: {
    mounted() {
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        const tabs = [...this.el.querySelectorAll("[role='tab']")];
        const next = tabs[(tabs.indexOf(document.activeElement) + by + tabs.length) % tabs.length];
        pushEvent("select_tab", { id: next.dataset.drag });
        next.focus();
      });
    },
  },

  Drop: {
    mounted() {
      this.el.addEventListener("dragstart", (e) => {
        const from = e.target.closest?.("[data-drag]");
        if (!from) return;
        e.dataTransfer.setData(PANEL, from.dataset.drag);
        e.dataTransfer.effectAllowed = "move";
        const box = this.el.querySelector(`#panel-${from.dataset.drag}`);
        if (box) e.dataTransfer.setDragImage(box, 12, 12);
      });
      this.el.addEventListener("dragover", (e) => {
        const place = this.findPlace(e);
        if (place === undefined) return;
        this.markTarget(place);
        e.preventDefault();
      });
      this.el.addEventListener("dragleave", (e) => this.el.contains(e.relatedTarget) || this.markTarget(null));
      this.el.addEventListener("drop", (e) => {
        const place = this.findPlace(e);
        this.markTarget(null);
        if (place === undefined) return;
        e.preventDefault();
        const stream = e.dataTransfer.getData(STREAM);
        const { side, target } = place ?? {};
        if (stream && side !== "into" && side) pushEvent("add_stream", { stream, panel: "", side, target });
        else if (stream)
          pushEvent("add_stream", { stream, panel: e.target.closest("[data-panel]")?.dataset.panel ?? "" });
        else if (place) pushEvent("place_panel", { id: e.dataTransfer.getData(PANEL), side, target });
      });
      this.end = () => this.markTarget(null);
      document.addEventListener("dragend", this.end);
    },
    destroyed() {
      document.removeEventListener("dragend", this.end);
    },
    // Returns the place for what is dragged; undefined if it is neither a panel nor a stream.
    findPlace(e) {
      const { types } = e.dataTransfer;
      if (types.includes(PANEL)) return dropTargetAt(this.el, e, "tab");
      return types.includes(STREAM) ? dropTargetAt(this.el, e, "into") : undefined;
    },
    markTarget(place) {
      const el = place?.el ?? null;
      if (this.marked && this.marked !== el) delete this.marked.dataset.drop;
      if (el) el.dataset.drop = place.side;
      this.marked = el;
    },
  },
};

export const dragStream = (e) => {
  const row = e.target.closest(".node[data-stream]");
  if (row) e.dataTransfer.setData(STREAM, row.dataset.stream);
};
