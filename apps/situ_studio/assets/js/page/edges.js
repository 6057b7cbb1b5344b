// The edges between rows and between columns: dragged, or moved with the arrow keys.

export const hooks = {
  // The lower edge of a row: drag it, or move it with the arrow keys.
  Resize: {
    mounted() {
      const row = this.el.parentElement;
      const done = () => this.pushEvent("resize_row", { id: row.dataset.row, height: Math.round(row.offsetHeight) });
      this.el.addEventListener("pointerdown", (e) => {
        e.preventDefault();
        this.el.setPointerCapture(e.pointerId);
        const start = e.clientY,
          height = row.offsetHeight;
        const move = (m) => (row.style.height = `${Math.max(32, height + m.clientY - start)}px`);
        const up = () => {
          this.el.removeEventListener("pointermove", move);
          done();
        };
        this.el.addEventListener("pointermove", move);
        this.el.addEventListener("pointerup", up, { once: true });
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowDown: 10, ArrowUp: -10 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        row.style.height = `${Math.max(32, row.offsetHeight + by)}px`;
        done();
      });
    },
  },

  // Between two columns: drag it, or move it with the arrow keys. The width is a variable of the style, kept in the
  // browser.
  Split: {
    mounted() {
      const { var: name, edge } = this.el.dataset;
      const parent = this.el.parentElement;
      const set = (px) => {
        document.documentElement.style.setProperty(name, `${Math.round(px)}px`);
        this.el.setAttribute("aria-valuenow", String(Math.round((100 * px) / innerWidth)));
        try {
          localStorage.setItem(`situ:${name}`, String(Math.round(px)));
        } catch {
          // it lasts as long as the page
        }
      };
      const width = () => parent.getBoundingClientRect().width;
      const bound = (px) => Math.min(Math.max(px, 120), innerWidth * 0.7);
      this.el.addEventListener("pointerdown", (e) => {
        e.preventDefault();
        this.el.setPointerCapture(e.pointerId);
        const start = e.clientX,
          from = width();
        const move = (m) => set(bound(from + (edge === "right" ? 1 : -1) * (m.clientX - start)));
        this.el.addEventListener("pointermove", move);
        this.el.addEventListener("pointerup", () => this.el.removeEventListener("pointermove", move), { once: true });
      });
      this.el.addEventListener("keydown", (e) => {
        const by = { ArrowLeft: -20, ArrowRight: 20 }[e.key];
        if (!by) return;
        e.preventDefault();
        e.stopPropagation();
        set(bound(width() + (edge === "right" ? by : -by)));
      });
      this.el.addEventListener("dblclick", () => document.documentElement.style.removeProperty(name));
    },
  },
};
