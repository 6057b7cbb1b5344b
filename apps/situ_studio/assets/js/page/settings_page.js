// The part of the settings that this browser keeps: what people chose, and the keys.

import { SETTINGS, choose, setting } from "./settings.js";
import { giveKey, keyName, keys, usualKeys } from "./keys.js";
import { toast } from "./toast.js";

const make = (parent, tag, more = {}) => Object.assign(parent.appendChild(document.createElement(tag)), more);

// One choice or one yes.
function field(form, { id, title, choices }) {
  const row = make(form, "div", { className: "field" });
  make(row, "label", { textContent: title, htmlFor: `setting-${id}` });
  if (!choices) {
    const box = make(row, "input", { type: "checkbox", id: `setting-${id}`, checked: setting(id) });
    box.addEventListener("change", () => choose(id, box.checked));
    return;
  }
  const select = make(row, "select", { id: `setting-${id}` });
  for (const [value, text] of choices)
    make(select, "option", { value: String(value), textContent: text, selected: value === setting(id) });
  select.addEventListener("change", () => choose(id, choices[select.selectedIndex][0]));
}

// A key: click it, press another. Escape leaves it as it was, Delete gives it its usual one again.
function keyRow(table, [key, text, , usual], redraw) {
  const row = make(table, "div", { className: "field key" });
  make(row, "span", { textContent: text });
  const b = make(row, "button", { type: "button", className: "btn", textContent: key.replace("Arrow", "") });
  b.dataset.usual = usual;
  b.setAttribute("aria-label", `${text}: ${key}. Change`);
  b.classList.toggle("own", key !== usual);
  b.addEventListener("click", () => {
    b.textContent = "press a key";
    b.classList.add("waiting");
    const pressed = (e) => {
      if (["Control", "Shift", "Alt", "Meta"].includes(e.key)) return;
      e.preventDefault();
      e.stopPropagation();
      done();
      if (e.key === "Escape") return redraw(usual);
      const wanted = e.key === "Delete" ? null : keyName(e);
      const taken = giveKey(usual, wanted);
      if (taken) toast(`${wanted ?? usual} is taken: ${taken}`);
      redraw(usual);
    };
    const done = () => {
      b.removeEventListener("keydown", pressed);
      b.removeEventListener("blur", left);
    };
    const left = () => {
      done();
      b.textContent = key.replace("Arrow", "");
      b.classList.remove("waiting");
    };
    b.addEventListener("keydown", pressed);
    b.addEventListener("blur", left);
  });
}

export const hooks = {
  BrowserSettings: {
    mounted() {
      const form = make(this.el, "div", { className: "fields" });
      for (const s of SETTINGS) field(form, s);
      make(this.el, "h2", { textContent: "Keys" });
      make(this.el, "p", {
        className: "hint",
        textContent: "Click a key and press another; Delete is the usual one.",
      });
      const table = make(this.el, "div", { className: "fields keys" });
      const draw = (focused) => {
        table.textContent = "";
        for (const row of keys()) keyRow(table, row, draw);
        if (focused) table.querySelector(`[data-usual="${CSS.escape(focused)}"]`)?.focus();
      };
      draw();
      const all = make(this.el, "button", { type: "button", className: "btn", textContent: "All keys as usual" });
      all.addEventListener("click", () => {
        usualKeys();
        draw();
      });
    },
  },
};
