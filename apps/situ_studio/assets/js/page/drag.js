// Streams dragged from the tree to panels, and panels to other places. A panel is moved by keys, too.

const STREAM = "application/x-situ-stream";
// The thing dragged can be read at the drop only; its kind, all the way.
const PANEL = { line: "application/x-situ-line", cell: "application/x-situ-cell" };
const WAYS = { ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right" };
// How near to the upper or lower edge of a cell a cell goes out of its row: a part of the height.
const EDGE = 0.22;

// Which side of a box a point is on. Cells over cells stand side by side, but above and below near the edges.
export function sideOf({ left, top, width, height }, x, y, cells) {
  const down = (y - top) / height;
  if (!cells || down < EDGE || down > 1 - EDGE) return down < 0.5 ? "above" : "below";
  return x < left + width / 2 ? "left" : "right";
}

// Where a dragged panel would go: {side, target, el}, or null over nothing.
function placeAt(e, kind) {
  const row = e.target.closest?.("[data-row]");
  if (!row) return null;
  const cell = kind === "cell" ? e.target.closest("[data-panel].cell") : null;
  const side = sideOf((cell ?? row).getBoundingClientRect(), e.clientX, e.clientY, cell !== null);
  const beside = side === "left" || side === "right";
  return { side, target: beside ? cell.dataset.panel : row.dataset.row, el: beside ? cell : row };
}

const kindOf = (e) => Object.keys(PANEL).find((k) => e.dataTransfer.types.includes(PANEL[k]));

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
        // an element that changes its place loses the focus
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
        const kind = kindOf(e);
        if (kind) this.mark(placeAt(e, kind));
        else if (e.dataTransfer.types.includes(STREAM))
          this.mark({ side: "into", el: e.target.closest("[data-panel]") });
        else return;
        e.preventDefault();
      });
      this.el.addEventListener("dragleave", (e) => this.el.contains(e.relatedTarget) || this.mark(null));
      this.el.addEventListener("drop", (e) => {
        const kind = kindOf(e);
        const place = kind && placeAt(e, kind);
        const stream = e.dataTransfer.getData(STREAM);
        this.mark(null);
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
      this.end = () => this.mark(null);
      document.addEventListener("dragend", this.end);
    },
    destroyed() {
      document.removeEventListener("dragend", this.end);
    },
    mark(place) {
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
