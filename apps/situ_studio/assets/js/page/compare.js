// Two recordings on one axis: the second is shifted by dragging, by keys, by a number, or so that two moments fall
// together. The shift is a BigInt of nanoseconds: recordings may be years apart.

import { duration, parseTime } from "../time/text.js";
import { GUTTER } from "./theme.js";
import { toast } from "./toast.js";

// The server is told where the shift came to rest.
const SETTLED = 150;

export class Compare {
  constructor(el, app) {
    Object.assign(this, { el, app });
    const { offset, first, second } = el.dataset;
    this.offset = BigInt(offset);
    [this.first, this.second] = [first, second].map((t) => t.split("~").map(BigInt));
    this.marks = {};
    this.input = el.querySelector("input");
    this.handle = el.querySelector(".shift");
    this.handle.addEventListener("pointerdown", (e) => this.drag(e));
    this.handle.addEventListener("keydown", (e) => this.key(e));
    this.input.addEventListener("change", () => this.typed());
    el.addEventListener("click", (e) => this.align(e.target.closest("[data-align]")?.dataset.align));
    this.show();
  }

  // Both begin together when nothing is shifted.
  get together() {
    return this.first[0] - this.second[0];
  }

  nsPerPixel() {
    const { view } = this.app.time.get();
    const width = document.getElementById("navigator").clientWidth - GUTTER.left - GUTTER.right;
    return (view[1] - view[0]) / Math.max(width, 1);
  }

  drag(e) {
    e.preventDefault();
    this.handle.focus();
    this.handle.setPointerCapture(e.pointerId);
    const from = this.offset,
      x = e.clientX;
    const move = (m) => this.set(from + BigInt(Math.round((m.clientX - x) * this.nsPerPixel())));
    this.handle.addEventListener("pointermove", move);
    this.handle.addEventListener("pointerup", () => this.handle.removeEventListener("pointermove", move), {
      once: true,
    });
  }

  key(e) {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (!way) return;
    e.preventDefault();
    e.stopPropagation();
    this.set(this.offset + BigInt(Math.round(way * (e.shiftKey ? 10 : 1) * this.nsPerPixel())));
  }

  typed() {
    const t = parseTime(this.input.value.trim().replace(/^\+/, ""), 0n);
    if (t === null) toast("Not a length of time. Try 1.25 s, -40 ms or 1:30");
    else this.set(this.together + BigInt(Math.round(t)));
    this.show();
  }

  align(how) {
    if (how === "begin") this.set(this.together);
    else if (how === "end") this.set(this.first[1] - this.second[1]);
    else if (how === "clock") this.set(0n);
    else if (how === "stop") location.assign(location.pathname);
  }

  // A moment of the first or of the second recording, as a time of the page: two of them fall together.
  mark(which, t) {
    this.marks[which] = t;
    const { first, second } = this.marks;
    if (first == null || second == null) return this.show();
    this.marks = {};
    this.set(this.offset + BigInt(Math.round(first - second)));
    toast("The two moments fall together");
  }

  set(offset) {
    this.offset = offset;
    this.app.client.setOffset(offset.toString());
    this.show();
    this.app.address.save();
    clearTimeout(this.told);
    this.told = setTimeout(() => this.app.options.push?.("compare_offset", { offset: offset.toString() }), SETTLED);
  }

  show() {
    const late = Number(this.offset - this.together);
    if (document.activeElement !== this.input || parseTime(this.input.value, 0n) !== null)
      this.input.value = `${(late / 1e9).toFixed(3)} s`;
    this.handle.setAttribute("aria-valuenow", (late / 1e9).toFixed(3));
    this.handle.setAttribute("aria-valuetext", duration(late));
    const { first, second } = this.marks;
    const { title, other } = this.el.dataset;
    this.el.querySelector(".marks").textContent =
      first != null ? `now a moment of ${other}` : second != null ? `now a moment of ${title}` : "";
  }

  destroy() {
    clearTimeout(this.told);
  }
}
