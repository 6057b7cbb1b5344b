// Resizes rows and columns by dragging the edges between them, or with the arrow keys.

export const hooks = {
  // The lower edge of a row.
  Resize: {
    mounted() {
      const row = this.el.parentElement;
      const pushHeight = () =>
        this.pushEvent("resize_row", { id: row.dataset.row, height: Math.round(row.offsetHeight) });
      this.el.addEventListener("pointerdown", (e) => {
        e.preventDefault();
        this.el.setPointerCapture(e.pointerId);
        const start = e.clientY,
          height = row.offsetHeight;
        const moveEdge = (m) => (row.style.height = `${Math.max(32, height + m.clientY - start)}px`);
        const endDrag = () => {
          this.el.removeEventListener("pointermove", moveEdge);
          pushHeight();
        };
        this.el.addEventListener("pointermove", moveEdge);
        this.el.addEventListener("pointerup", endDrag, { once: true });
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowDown: 10, ArrowUp: -10 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        row.style.height = `${Math.max(32, row.offsetHeight + by)}px`;
        pushHeight();
      });
    },
  },

  // The edge between two columns. The width is a CSS variable that is stored in the browser.
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
        e.preventDefault();
        this.el.setPointerCapture(e.pointerId);
        const start = e.clientX,
          from = columnWidth();
        const moveEdge = (m) => setWidth(clampWidth(from + (edge === "right" ? 1 : -1) * (m.clientX - start)));
        this.el.addEventListener("pointermove", moveEdge);
        this.el.addEventListener("pointerup", () => this.el.removeEventListener("pointermove", moveEdge), {
          once: true,
        });
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
