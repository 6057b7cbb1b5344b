// Compares two recordings on one axis. The second one is shifted by dragging, by keys, by entering a number, or by
// aligning two moments. The offset is a BigInt of nanoseconds, since recordings may be years apart.

import { formatDuration, parseTime } from "../time/text.js";
import { GUTTER } from "./theme.js";
import { showToast } from "./toast.js";
import { getElement } from "./dom.js";

// The server receives the offset after it has not changed for this many ms.
const SETTLED = 150;

export class Compare {
  constructor(el, app) {
    this.el = el;
    this.app = app;
    const { offset, first, second } = el.dataset;
    this.offset = BigInt(offset);
    /** @returns {bigint[]} */
    const parseExtent = (text) => text.split("~").map(BigInt);
    this.first = parseExtent(first);
    this.second = parseExtent(second);
    this.marks = {};
    this.input = el.querySelector("input");
    this.handle = el.querySelector(".shift");
    this.handle.addEventListener("pointerdown", (e) => this.startDrag(e));
    this.handle.addEventListener("keydown", (e) => this.handleKey(e));
    this.input.addEventListener("change", () => this.applyInput());
    el.addEventListener("click", (e) => this.alignBy(e.target.closest("[data-align]")?.dataset.align));
    this.showOffset();
  }

  // The offset at which both recordings begin at the same time.
  get alignedStart() {
    return this.first[0] - this.second[0];
  }

  nsPerPixel() {
    const { view } = this.app.time.get();
    const width = getElement("navigator").clientWidth - GUTTER.left - GUTTER.right;
    return (view[1] - view[0]) / Math.max(width, 1);
  }

  startDrag(e) {
    e.preventDefault();
    this.handle.focus();
    this.handle.setPointerCapture(e.pointerId);
    const from = this.offset,
      x = e.clientX;
    const moveOffset = (m) => this.setOffset(from + BigInt(Math.round((m.clientX - x) * this.nsPerPixel())));
    this.handle.addEventListener("pointermove", moveOffset);
    this.handle.addEventListener("pointerup", () => this.handle.removeEventListener("pointermove", moveOffset), {
      once: true,
    });
  }

  handleKey(e) {
    const way = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (!way) return;
    e.preventDefault();
    e.stopPropagation();
    this.setOffset(this.offset + BigInt(Math.round(way * (e.shiftKey ? 10 : 1) * this.nsPerPixel())));
  }

  applyInput() {
    const t = parseTime(this.input.value.trim().replace(/^\+/, ""), 0n);
    if (t === null) showToast("Not a duration. Try 1.25 s, -40 ms or 1:30");
    else this.setOffset(this.alignedStart + BigInt(Math.round(t)));
    this.showOffset();
  }

  alignBy(how) {
    if (how === "begin") this.setOffset(this.alignedStart);
    else if (how === "end") this.setOffset(this.first[1] - this.second[1]);
    else if (how === "clock") this.setOffset(0n);
    else if (how === "stop") location.assign(location.pathname);
  }

  // Marks a moment of the first or second recording (a time of the page). Two marked moments are aligned.
  markMoment(which, t) {
    this.marks[which] = t;
    const { first, second } = this.marks;
    if (first == null || second == null) return this.showOffset();
    this.marks = {};
    this.setOffset(this.offset + BigInt(Math.round(first - second)));
    showToast("The two moments are aligned");
  }

  setOffset(offset) {
    this.offset = offset;
    this.app.client.setOffset(offset.toString());
    this.showOffset();
    this.app.address.save();
    clearTimeout(this.pushTimer);
    this.pushTimer = setTimeout(
      () => this.app.options.push?.("compare_offset", { offset: offset.toString() }),
      SETTLED,
    );
  }

  showOffset() {
    const late = Number(this.offset - this.alignedStart);
    if (document.activeElement !== this.input || parseTime(this.input.value, 0n) !== null)
      this.input.value = `${(late / 1e9).toFixed(3)} s`;
    this.handle.setAttribute("aria-valuenow", (late / 1e9).toFixed(3));
    this.handle.setAttribute("aria-valuetext", formatDuration(late));
    const { first, second } = this.marks;
    const { title, other } = this.el.dataset;
    this.el.querySelector(".marks").textContent =
      first != null ? `now mark a moment of ${other}` : second != null ? `now mark a moment of ${title}` : "";
  }

  destroy() {
    clearTimeout(this.pushTimer);
  }
}
