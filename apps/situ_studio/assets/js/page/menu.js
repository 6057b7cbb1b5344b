// A menu for the right mouse button, the menu key and a long touch. `menus.js` provides the entries.

import { focusedElement } from "./dom.js";

const LONG = 550;

export class Menu {
  // itemsFor(target, event) -> [{text, hint?, run, disabled?} or "-"], or null if there is no menu
  constructor(root, itemsFor) {
    this.itemsFor = itemsFor;
    // a landmark, so that users of screen readers can find it
    this.landmark = document.body.appendChild(document.createElement("nav"));
    this.landmark.setAttribute("aria-label", "Menu");
    this.el = this.landmark.appendChild(document.createElement("div"));
    this.el.id = "menu";
    this.el.setAttribute("role", "menu");
    this.el.hidden = this.landmark.hidden = true;
    root.addEventListener("contextmenu", (e) => this.handleContextMenu(e));
    root.addEventListener("pointerdown", (e) => this.handlePointerDown(e));
    for (const name of ["pointerup", "pointercancel", "pointermove"])
      root.addEventListener(name, (e) => this.cancelLongTouch(e));
    this.at = [0, 0];
    this.el.addEventListener("keydown", (e) => this.handleKey(e));
    this.outside = (e) => this.el.contains(e.target) || this.close();
    document.addEventListener("pointerdown", this.outside, true);
    addEventListener("blur", () => this.close());
  }

  handleContextMenu(e) {
    // Shift+click ends a selection, and fields keep the browser's own menu
    if (e.shiftKey || e.target.closest("input, textarea, select")) return;
    const items = this.itemsFor(e.target, e);
    if (!items?.length) return;
    e.preventDefault();
    this.open(items, e.clientX, e.clientY);
  }

  handlePointerDown(e) {
    if (e.pointerType !== "touch") return;
    this.at = [e.clientX, e.clientY];
    this.timer = setTimeout(() => this.handleContextMenu(e), LONG);
  }

  cancelLongTouch(e) {
    if (!this.timer) return;
    if (e.type === "pointermove" && Math.hypot(e.clientX - this.at[0], e.clientY - this.at[1]) < 8) return;
    clearTimeout(this.timer);
    this.timer = null;
  }

  open(items, x, y) {
    this.back = focusedElement();
    this.el.textContent = "";
    for (const item of items) {
      if (item === "-") {
        this.el.appendChild(document.createElement("hr"));
        continue;
      }
      const b = this.el.appendChild(document.createElement("button"));
      b.type = "button";
      b.setAttribute("role", "menuitem");
      b.disabled = item.disabled === true;
      b.appendChild(document.createElement("span")).textContent = item.text;
      if (item.hint) b.appendChild(document.createElement("kbd")).textContent = item.hint;
      b.addEventListener("click", () => {
        this.close();
        item.run();
      });
    }
    this.el.hidden = this.landmark.hidden = false;
    const { offsetWidth: w, offsetHeight: h } = this.el;
    this.el.style.left = `${Math.max(4, Math.min(x, innerWidth - w - 4))}px`;
    this.el.style.top = `${Math.max(4, Math.min(y, innerHeight - h - 4))}px`;
    this.enabledButtons()[0]?.focus({ preventScroll: true });
  }

  enabledButtons() {
    return /** @type {HTMLElement[]} */ ([...this.el.querySelectorAll("button:not(:disabled)")]);
  }

  handleKey(e) {
    const all = this.enabledButtons();
    const i = all.findIndex((button) => button === document.activeElement);
    if (e.key === "ArrowDown") all[(i + 1) % all.length].focus();
    else if (e.key === "ArrowUp") all[(i + all.length - 1) % all.length].focus();
    else if (e.key === "Home") all[0].focus();
    else if (e.key === "End") all.at(-1)?.focus();
    else if (e.key === "Escape" || e.key === "Tab") this.close();
    else return;
    e.preventDefault();
    e.stopPropagation();
  }

  close() {
    if (this.el.hidden) return;
    this.el.hidden = this.landmark.hidden = true;
    if (this.el.contains(document.activeElement)) this.back?.focus({ preventScroll: true });
  }

  destroy() {
    document.removeEventListener("pointerdown", this.outside, true);
    this.landmark.remove();
  }
}
