// Times at the lower edge of a timeline that is not as wide as the time navigator, whose ruler does not fit it.

import { formatClock, rulerTicks } from "./clock.js";

const SPACE = 64;

export class OwnRuler {
  // `app` has the client, whose origin is the time of 0.
  constructor(box, app) {
    this.el = box.appendChild(document.createElement("div"));
    this.el.className = "own-ruler";
    this.app = app;
    this.shown = "";
  }

  update(view, inner, width) {
    const { origin } = this.app.client;
    const wide = document.getElementById("navigator")?.clientWidth || width;
    this.el.hidden = origin === null || Math.abs(wide - width) < 2 || inner < SPACE;
    if (this.el.hidden) return;
    const rule = rulerTicks(view, inner, origin, SPACE);
    const texts = rule.at.map((t) => formatClock(t, origin, rule.unit));
    const key = `${view} ${inner} ${texts}`;
    if (key === this.shown) return;
    this.shown = key;
    this.el.textContent = "";
    rule.at.forEach((t, i) => {
      const x = ((t - view[0]) / (view[1] - view[0])) * inner;
      if (x > inner - SPACE / 2) return;
      const label = this.el.appendChild(document.createElement("span"));
      label.textContent = texts[i];
      label.style.left = `${x}px`;
    });
  }
}
