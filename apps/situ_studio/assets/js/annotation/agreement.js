// Shows in a table how well two annotation layers agree, and lets the user choose the second layer.

export function showAgreement({ first, second, rows }) {
  const dialog = openDialog("agreement", `${first} and ${second}`);
  const table = dialog.appendChild(document.createElement("table"));
  for (const [name, value] of rows) {
    const tr = table.appendChild(document.createElement("tr"));
    tr.appendChild(document.createElement("th")).textContent = name;
    tr.appendChild(document.createElement("td")).textContent = value;
  }
  dialog.showModal();
}

export function chooseLayer(streams, chosen) {
  const dialog = openDialog("agreement-with", "Compare with");
  if (!streams.length) {
    dialog.appendChild(document.createElement("p")).textContent =
      "This recording has no other annotations. Another annotator can create a layer in the annotation dialog (a).";
  }
  const choices = dialog.appendChild(document.createElement("div"));
  choices.className = "choices";
  for (const stream of streams) {
    const b = choices.appendChild(document.createElement("button"));
    Object.assign(b, { type: "button", className: "btn", textContent: stream });
    b.addEventListener("click", () => {
      dialog.close();
      chosen(stream);
    });
  }
  dialog.showModal();
}

function openDialog(id, title) {
  document.getElementById(id)?.remove();
  const dialog = document.body.appendChild(document.createElement("dialog"));
  dialog.id = id;
  dialog.className = "table";
  dialog.setAttribute("aria-label", title);
  dialog.appendChild(document.createElement("h3")).textContent = title;
  dialog.addEventListener("close", () => dialog.remove());
  dialog.addEventListener("click", (e) => e.target === dialog && dialog.close());
  return dialog;
}
