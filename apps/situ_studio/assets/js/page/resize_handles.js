// Resizes panels and sidebars by dragging the edges between them, or with the arrow keys.

import { pushEvent } from "./channel.js";

// Calls `move` with the distance of the pointer from where the drag began, and `end` when it is released.
function dragEdge(el, e, move, end) {
  e.preventDefault();
  el.setPointerCapture(e.pointerId);
  const { clientX, clientY } = e;
  const moveEdge = (m) => move(m.clientX - clientX, m.clientY - clientY);
  const endDrag = () => {
    el.removeEventListener("pointermove", moveEdge);
    end();
  };
  el.addEventListener("pointermove", moveEdge);
  el.addEventListener("pointerup", endDrag, { once: true });
}

// The smallest parts, in pixels.
const LEAST_HEIGHT = 32,
  LEAST_WIDTH = 80;

export const hooks = {
  // The lower edge of a part of a column. A double-click gives the part the height of its content again.
  Resize: {
    mounted() {
      const part = () => this.el.previousElementSibling;
      const setHeight = (px) =>
        Object.assign(part().style, {
          flex: `0 0 ${Math.max(LEAST_HEIGHT, Math.round(px))}px`,
          minHeight: "0",
          maxHeight: "none",
          aspectRatio: "auto",
        });
      const pushHeight = (height) => pushEvent("resize_part", { id: part().dataset.part, height });
      const keep = () => pushHeight(Math.round(part().offsetHeight));
      this.el.addEventListener("pointerdown", (e) => {
        const height = part().offsetHeight;
        let moved = false;
        const move = (_, by) => {
          moved ||= Math.abs(by) > 2;
          if (moved) setHeight(height + by);
        };
        dragEdge(this.el, e, move, () => moved && keep());
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowDown: 10, ArrowUp: -10 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        setHeight(part().offsetHeight + by);
        keep();
      });
      this.el.addEventListener("dblclick", () => pushHeight(null));
    },
  },

  // The edge between two parts of a row. A double-click gives all parts the widths of their content again.
  RowSplit: {
    mounted() {
      const { row } = this.el.dataset;
      const listParts = () => [...this.el.parentElement.children].filter((c) => !c.matches(".split"));
      const listWidths = () => listParts().map((c) => c.getBoundingClientRect().width);
      const place = () => listParts().indexOf(this.el.previousElementSibling);
      // Returns the widths after moving this edge.
      const moveEdge = (widths, by) => {
        const i = place();
        const both = widths[i] + widths[i + 1];
        const least = Math.min(LEAST_WIDTH, both / 2);
        const first = Math.min(Math.max(widths[i] + by, least), both - least);
        return widths.with(i, first).with(i + 1, both - first);
      };
      const show = (widths) => listParts().forEach((c, i) => (c.style.flex = `${widths[i]} 1 0%`));
      const keep = (widths) => {
        const all = widths.reduce((sum, w) => sum + w, 0);
        pushEvent("resize_row", { id: row, shares: widths.map((w) => (100 * w) / all) });
      };
      this.el.addEventListener("pointerdown", (e) => {
        const widths = listWidths();
        /** @type {number[] | null} */
        let last = null;
        dragEdge(
          this.el,
          e,
          (by) => {
            if (last || Math.abs(by) > 2) show((last = moveEdge(widths, by)));
          },
          () => last && keep(last),
        );
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowLeft: -20, ArrowRight: 20 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        const widths = moveEdge(listWidths(), by);
        show(widths);
        keep(widths);
      });
      this.el.addEventListener("dblclick", () => pushEvent("resize_row", { id: row, shares: null }));
    },
  },

  // The edge of a sidebar. The width is a CSS variable that is stored in the browser.
  Split: {
    mounted() {
      const { var: name, edge } = this.el.dataset;
      const parent = this.el.parentElement;
      const setWidth = (px) => {
        document.documentElement.style.setProperty(name, `${Math.round(px)}px`);
        this.el.setAttribute("aria-valuenow", String(Math.round((100 * px) / innerWidth)));
        try {
          localStorage.setItem(`situ:${name}`, String(Math.round(px)));
        } catch {
          // no storage: the width lasts until the page is closed
        }
      };
      const columnWidth = () => parent.getBoundingClientRect().width;
      const clampWidth = (px) => Math.min(Math.max(px, 120), innerWidth * 0.7);
      this.el.addEventListener("pointerdown", (e) => {
        const from = columnWidth();
        const way = edge === "right" ? 1 : -1;
        dragEdge(
          this.el,
          e,
          (by) => setWidth(clampWidth(from + way * by)),
          () => {},
        );
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowLeft: -20, ArrowRight: 20 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        setWidth(clampWidth(columnWidth() + (edge === "right" ? by : -by)));
      });
      this.el.addEventListener("dblclick", () => document.documentElement.style.removeProperty(name));
    },
  },
};
