// Drags streams from the tree to panels, and panels to other positions. Panels can also be moved by keys.

const STREAM = "application/x-situ-stream";
// The dragged item can only be read on drop; its kind is available all the time.
const PANEL = { line: "application/x-situ-line", cell: "application/x-situ-cell" };
const WAYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right" };
// A cell that is dropped this close to the upper or lower edge of another, as a share of its height, leaves the row.
const EDGE = 0.22;

// Returns the side of a box that a point is on. Cells go next to cells, but above or below near the edges.
export function dropSide({ left, top, width, height }, x, y, cells) {
  const down = (y - top) / height;
  if (!cells || down < EDGE || down > 1 - EDGE) return down < 0.5 ? "above" : "below";
  return x < left + width / 2 ? "left" : "right";
}

// Returns where a dragged panel would go: {side, target, el}, or null.
function dropTargetAt(e, kind) {
  const row = e.target.closest?.("[data-row]");
  if (!row) return null;
  const cell = kind === "cell" ? e.target.closest("[data-panel].cell") : null;
  const side = dropSide((cell ?? row).getBoundingClientRect(), e.clientX, e.clientY, cell !== null);
  const beside = side === "left" || side === "right";
  return { side, target: beside ? cell.dataset.panel : row.dataset.row, el: beside ? cell : row };
}

const draggedKind = (e) => Object.keys(PANEL).find((k) => e.dataTransfer.types.includes(PANEL[k]));

export const hooks = {
  Grip: {
    mounted() {
      const { id, grip } = this.el.dataset;
      this.el.addEventListener("dragstart", (e) => {
        e.dataTransfer.setData(PANEL[grip], id);
        e.dataTransfer.effectAllowed = "move";
        const panel = this.el.closest("[data-panel]");
        e.dataTransfer.setDragImage(panel, 12, 12);
      });
      this.el.addEventListener("keydown", (e) => {
        const way = WAYS[e.key];
        if (!way || e.altKey || e.ctrlKey || e.metaKey || e.shiftKey) return;
        e.preventDefault();
        e.stopPropagation();
        // an element that is moved loses the focus
        this.pushEvent("shift_panel", { id, way }, () =>
          requestAnimationFrame(() => {
            this.el.focus();
            this.el.scrollIntoView({ block: "nearest" });
          }),
        );
      });
    },
  },

  Drop: {
    mounted() {
      this.el.addEventListener("dragover", (e) => {
        const kind = draggedKind(e);
        if (kind) this.markTarget(dropTargetAt(e, kind));
        else if (e.dataTransfer.types.includes(STREAM))
          this.markTarget({ side: "into", el: e.target.closest("[data-panel]") });
        else return;
        e.preventDefault();
      });
      this.el.addEventListener("dragleave", (e) => this.el.contains(e.relatedTarget) || this.markTarget(null));
      this.el.addEventListener("drop", (e) => {
        const kind = draggedKind(e);
        const place = kind && dropTargetAt(e, kind);
        const stream = e.dataTransfer.getData(STREAM);
        this.markTarget(null);
        if (!kind && !stream) return;
        e.preventDefault();
        if (stream) {
          const panel = e.target.closest("[data-panel]")?.dataset.panel ?? "";
          this.pushEvent("add_stream", { stream, panel });
        } else if (place) {
          const id = e.dataTransfer.getData(PANEL[kind]);
          this.pushEvent("place_panel", { id, side: place.side, target: place.target });
        }
      });
      this.end = () => this.markTarget(null);
      document.addEventListener("dragend", this.end);
    },
    destroyed() {
      document.removeEventListener("dragend", this.end);
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
