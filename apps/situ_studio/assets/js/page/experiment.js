// The page of experiments: marking ranges of axes in the parallel coordinates, and comments.

import { readAnnotator, setAnnotator } from "../annotation/annotator.js";

// A shorter movement is a click, which clears the range of the axis.
const CLICK = 4;

// Returns the position on an axis, 0 at its lower end and 1 at its upper end.
export function axisPosition(y, { top, bottom }) {
  return Math.min(Math.max((bottom - y) / (bottom - top), 0), 1);
}

export const hooks = {
  Brush: {
    mounted() {
      this.el.addEventListener("pointerdown", (e) => this.startRange(e));
    },
    startRange(e) {
      const grip = e.target.closest(".grip");
      if (!grip || e.button !== 0) return;
      e.preventDefault();
      const axis = grip.closest(".axis").dataset.axis;
      const ends = { top: Number(this.el.dataset.top), bottom: Number(this.el.dataset.bottom) };
      const box = this.el.getBoundingClientRect();
      const begin = e.clientY - box.top;
      const range = this.addRange(grip);
      grip.setPointerCapture(e.pointerId);
      let end = begin;
      const moveRange = (m) => {
        end = m.clientY - box.top;
        const [a, b] = [begin, end].map((y) => Math.min(Math.max(y, ends.top), ends.bottom)).sort((p, q) => p - q);
        range.setAttribute("y", String(a));
        range.setAttribute("height", String(Math.max((b ?? 0) - (a ?? 0), 1)));
      };
      const finishRange = () => {
        grip.removeEventListener("pointermove", moveRange);
        range.remove();
        if (Math.abs(end - begin) < CLICK) this.pushEvent("clear", { axis });
        else this.pushEvent("brush", { axis, from: axisPosition(begin, ends), to: axisPosition(end, ends) });
      };
      grip.addEventListener("pointermove", moveRange);
      grip.addEventListener("pointerup", finishRange, { once: true });
    },
    // Draws the range until the server has drawn it.
    addRange(grip) {
      const range = document.createElementNS("http://www.w3.org/2000/svg", "rect");
      range.setAttribute("class", "range");
      range.setAttribute("x", String(Number(grip.closest(".axis").dataset.x) - 8));
      range.setAttribute("width", "16");
      range.setAttribute("height", "0");
      return this.el.appendChild(range);
    },
  },

  Comment: {
    mounted() {
      const name = this.el.querySelector("input[name=by]");
      name.value ||= readAnnotator() ?? "";
      this.el.addEventListener("submit", () => name.value.trim() && setAnnotator(name.value.trim()));
      this.handleEvent("commented", () => {
        this.el.querySelector("textarea").value = "";
      });
    },
  },
};
