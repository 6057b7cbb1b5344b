// The form of a smart cell: one text field for each label.
export function init(ctx, { fields, labels }) {
  const form = document.createElement("div");
  form.style.cssText = "display: flex; gap: 16px; font: 14px sans-serif; padding: 8px";
  const inputs = {};

  for (const [field, text] of labels) {
    const label = document.createElement("label");
    const input = document.createElement("input");
    label.append(text + " ", input);
    input.value = fields[field];
    input.addEventListener("change", () => ctx.pushEvent("update", { field, value: input.value }));
    inputs[field] = input;
    form.append(label);
  }

  ctx.root.append(form);
  ctx.handleEvent("update", ({ field, value }) => (inputs[field].value = value));
  // Livebook calls this before it evaluates the cell, when a field may still have the focus.
  ctx.handleSync(() => document.activeElement?.dispatchEvent(new Event("change")));
}
