// The browser settings of the settings page: choices and keys.

import { SETTINGS, changeSetting, readSetting } from "./settings.js";
import { assignKey, keyName, listKeys, resetKeys } from "./keys.js";
import { showToast } from "./toast.js";

const addElement = (parent, tag, more = {}) => Object.assign(parent.appendChild(document.createElement(tag)), more);

// Adds the field of a setting: a list of choices or a checkbox.
/** @param {HTMLElement} form @param {import("./settings.js").Setting} setting */
function addSetting(form, { id, title, choices }) {
  const row = addElement(form, "div", { className: "field" });
  addElement(row, "label", { textContent: title, htmlFor: `setting-${id}` });
  if (!choices) {
    const box = addElement(row, "input", { type: "checkbox", id: `setting-${id}`, checked: readSetting(id) });
    box.addEventListener("change", () => changeSetting(id, box.checked));
    return;
  }
  const select = addElement(row, "select", { id: `setting-${id}` });
  for (const [value, text] of choices)
    addElement(select, "option", { value: String(value), textContent: text, selected: value === readSetting(id) });
  select.addEventListener("change", () => changeSetting(id, choices[select.selectedIndex][0]));
}

// Adds the row of a key. Click it and press another key; Escape cancels, Delete restores the default.
function addKeyRow(table, [key, text, , usual], redraw) {
  const row = addElement(table, "div", { className: "field key" });
  addElement(row, "span", { textContent: text });
  const b = addElement(row, "button", { type: "button", className: "btn", textContent: key.replace("Arrow", "") });
  b.dataset.usual = usual;
  b.setAttribute("aria-label", `${text}: ${key}. Change`);
  b.classList.toggle("own", key !== usual);
  b.addEventListener("click", () => {
    b.textContent = "press a key";
    b.classList.add("waiting");
    const handleKey = (e) => {
      if (["Control", "Shift", "Alt", "Meta"].includes(e.key)) return;
      e.preventDefault();
      e.stopPropagation();
      stopListening();
      if (e.key === "Escape") return redraw(usual);
      const wanted = e.key === "Delete" ? null : keyName(e);
      const taken = assignKey(usual, wanted);
      if (taken) showToast(`${wanted ?? usual} is taken: ${taken}`);
      redraw(usual);
    };
    const stopListening = () => {
      b.removeEventListener("keydown", handleKey);
      b.removeEventListener("blur", restoreLabel);
    };
    const restoreLabel = () => {
      stopListening();
      b.textContent = key.replace("Arrow", "");
      b.classList.remove("waiting");
    };
    b.addEventListener("keydown", handleKey);
    b.addEventListener("blur", restoreLabel);
  });
}

export const hooks = {
  BrowserSettings: {
    mounted() {
      const form = addElement(this.el, "div", { className: "fields" });
      for (const s of SETTINGS) addSetting(form, s);
      addElement(this.el, "h2", { textContent: "Keys" });
      addElement(this.el, "p", {
        className: "hint",
        textContent: "Click a key and press another one. Delete restores the default.",
      });
      const table = addElement(this.el, "div", { className: "fields keys" });
      const drawKeys = (focused) => {
        table.textContent = "";
        for (const row of listKeys()) addKeyRow(table, row, drawKeys);
        if (focused) table.querySelector(`[data-usual="${CSS.escape(focused)}"]`)?.focus();
      };
      drawKeys();
      const all = addElement(this.el, "button", {
        type: "button",
        className: "btn",
        textContent: "Restore default keys",
      });
      all.addEventListener("click", () => {
        resetKeys();
        drawKeys();
      });
    },
  },
};
