// Asks questions in dialogs that replace the browser's: they match the page and do not block it. Escape, Cancel and
// a click outside return nothing.

import { focusedElement } from "./dom.js";

let count = 0;

// Asks for a text: {title, value?, type?, choices? (suggestions), actions? [[name, text]]} -> {action, text} or
// null.
/** @param {{title: string, value?: string, type?: string, choices?: string[], actions?: string[][]}} question */
export function askText({ title, value = "", type = "text", choices = [], actions = [["ok", "OK"]] }) {
  const dialog = openDialog(title);
  const form = dialog.appendChild(document.createElement("form"));
  form.method = "dialog";
  form.appendChild(document.createElement("h3")).textContent = title;
  const input = form.appendChild(document.createElement("input"));
  Object.assign(input, { type, value, autocomplete: "off", maxLength: 2000 });
  if (type === "number") input.step = "any";
  input.setAttribute("aria-label", title);
  if (choices.length) offerChoices(form, input, choices);
  addButtons(form, actions);
  return awaitAnswer(dialog, (name) => ({ action: name, text: input.value }), input);
}

// Asks for confirmation; `yes` is the text of the button.
export function confirmAction(text, yes = "OK") {
  const dialog = openDialog(text);
  const form = dialog.appendChild(document.createElement("form"));
  form.method = "dialog";
  form.appendChild(document.createElement("p")).textContent = text;
  addButtons(form, [["yes", yes]]);
  return awaitAnswer(dialog, () => true).then((found) => found === true);
}

function openDialog(title) {
  const dialog = document.body.appendChild(document.createElement("dialog"));
  dialog.id = "question";
  dialog.setAttribute("aria-label", title);
  return dialog;
}

function offerChoices(form, input, choices) {
  const list = form.appendChild(document.createElement("datalist"));
  list.id = `choices-${++count}`;
  for (const c of choices) list.appendChild(document.createElement("option")).value = c;
  input.setAttribute("list", list.id);
}

// Enter activates the first button.
function addButtons(form, actions) {
  const row = form.appendChild(document.createElement("div"));
  row.className = "choices";
  actions.forEach(([name, text], i) => {
    const b = row.appendChild(document.createElement("button"));
    Object.assign(b, { type: "submit", className: i ? "btn" : "btn primary", value: name, textContent: text });
  });
  const no = row.appendChild(document.createElement("button"));
  Object.assign(no, { type: "button", className: "btn", textContent: "Cancel" });
  no.addEventListener("click", () => form.closest("dialog").close(""));
}

function awaitAnswer(dialog, of, focused) {
  const back = focusedElement();
  dialog.addEventListener("click", (e) => e.target === dialog && dialog.close(""));
  dialog.showModal();
  (focused ?? dialog.querySelector("button")).focus();
  focused?.select();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      dialog.remove();
      back?.focus({ preventScroll: true });
      resolve(dialog.returnValue ? of(dialog.returnValue) : null);
    });
  });
}
