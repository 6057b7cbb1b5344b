// The page's own questions, in place of the browser's: they look like the page, wait for nobody, and Escape, Cancel and
// a click beside them answer nothing.

let count = 0;

// A text: {title, value?, type?, choices? (offered while typing), actions? [[name, text]]} -> {action, text} or null.
export function ask({ title, value = "", type = "text", choices = [], actions = [["ok", "OK"]] }) {
  const dialog = open(title);
  const form = dialog.appendChild(document.createElement("form"));
  form.method = "dialog";
  form.appendChild(document.createElement("h3")).textContent = title;
  const input = form.appendChild(document.createElement("input"));
  Object.assign(input, { type, value, autocomplete: "off", maxLength: 2000 });
  if (type === "number") input.step = "any";
  input.setAttribute("aria-label", title);
  if (choices.length) offer(form, input, choices);
  buttons(form, actions);
  return answer(dialog, (name) => ({ action: name, text: input.value }), input);
}

// Yes or no, with what happens on the button.
export function sure(text, yes = "OK") {
  const dialog = open(text);
  const form = dialog.appendChild(document.createElement("form"));
  form.method = "dialog";
  form.appendChild(document.createElement("p")).textContent = text;
  buttons(form, [["yes", yes]]);
  return answer(dialog, () => true).then((found) => found === true);
}

function open(title) {
  const dialog = document.body.appendChild(document.createElement("dialog"));
  dialog.id = "question";
  dialog.setAttribute("aria-label", title);
  return dialog;
}

function offer(form, input, choices) {
  const list = form.appendChild(document.createElement("datalist"));
  list.id = `choices-${++count}`;
  for (const c of choices) list.appendChild(document.createElement("option")).value = c;
  input.setAttribute("list", list.id);
}

// Enter is the first of them.
function buttons(form, actions) {
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

function answer(dialog, of, focused) {
  const back = document.activeElement;
  dialog.addEventListener("click", (e) => e.target === dialog && dialog.close(""));
  dialog.showModal();
  (focused ?? dialog.querySelector("button")).focus();
  focused?.select();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      dialog.remove();
      back?.focus?.({ preventScroll: true });
      resolve(dialog.returnValue ? of(dialog.returnValue) : null);
    });
  });
}
