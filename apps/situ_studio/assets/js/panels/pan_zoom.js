// Handles the mouse on a 2D panel: the wheel zooms about the mouse, dragging moves, a double click fits the view.

export class PanZoom {
  // fit() -> {x, y, k} with this zoom; changed() is called after a move, pointed() when only the mouse moved
  constructor(el, { fit, changed, pointed }) {
    this.zoom = { k: 1, x: 0, y: 0 };
    /** @type {[number, number] | null} */
    this.pointer = null;
    const listenTo = (name, f, options) => el.addEventListener(name, f, options);
    listenTo(
      "wheel",
      (e) => {
        e.preventDefault();
        const f = fit();
        const ix = (e.offsetX - f.x) / f.k,
          iy = (e.offsetY - f.y) / f.k;
        this.zoom.k = Math.min(Math.max(this.zoom.k * (e.deltaY > 0 ? 1 / 1.1 : 1.1), 0.2), 60);
        const g = fit();
        this.zoom.x += e.offsetX - (g.x + ix * g.k);
        this.zoom.y += e.offsetY - (g.y + iy * g.k);
        changed();
      },
      { passive: false },
    );
    /** @type {[number, number] | null} */
    let drag = null;
    listenTo("pointerdown", (e) => {
      el.setPointerCapture(e.pointerId);
      drag = [e.offsetX - this.zoom.x, e.offsetY - this.zoom.y];
    });
    listenTo("pointermove", (e) => {
      this.pointer = [e.offsetX, e.offsetY];
      if (!drag) return pointed();
      [this.zoom.x, this.zoom.y] = [e.offsetX - drag[0], e.offsetY - drag[1]];
      changed();
    });
    listenTo("pointerup", () => (drag = null));
    listenTo("pointerleave", () => {
      this.pointer = null;
      pointed();
    });
    listenTo("dblclick", () => {
      this.zoom = { k: 1, x: 0, y: 0 };
      changed();
    });
  }
}
