// The strip over the annotations: which attribute is shown, the value of the chosen one, tracks, proposals, undo, save.

import { ask } from "../page/ask.js";
import { annotator, setAnnotator } from "./annotator.js";

export class Tools {
  constructor(el, panel) {
    this.panel = panel;
    this.el = el.appendChild(document.createElement("div"));
    this.el.className = "annotation-tools";
    this.title = this.part("b");
    this.attribute = this.part("select", "Attribute");
    this.attribute.addEventListener("change", () => {
      panel.attribute = this.attribute.selectedIndex;
      panel.app.schedule(panel);
      this.update();
    });
    this.values = this.part("span");
    this.note = this.field("Note", "text", (note, item) => panel.push("note", { id: item.id, note }));
    this.confidence = this.field("Confidence, 0 to 1", "number", (text, item) =>
      panel.push("confidence", { id: item.id, confidence: text === "" ? null : Number(text) }),
    );
    Object.assign(this.confidence, { min: 0, max: 1, step: 0.05, placeholder: "confidence" });
    this.note.placeholder = "note";
    this.track = this.button("Track…", "Another track, a new one, or another name for this", () =>
      this.chooseTrack(),
    );
    this.button("Schema…", "Attributes, values, their keys and colours", () => this.ask("annotation_schema"));
    this.button("Agreement…", "How far this and another layer agree", () => this.ask("annotation_streams"));
    this.who = this.button("", "Whose name what is made bears", () => this.name());
    // proposals at and above a confidence are accepted, those below it rejected; it is seen while it is moved
    this.threshold = this.part("input", "Least confidence of proposals that are accepted");
    Object.assign(this.threshold, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    this.threshold.title = "Least confidence of proposals that are accepted";
    this.threshold.addEventListener("input", () => {
      this.update();
      panel.app.schedule(panel);
    });
    this.accept = this.button("Accept", "", () => this.settle("accept"));
    this.reject = this.button("Reject", "", () => this.settle("reject"));
    this.undo = this.button("Undo", "Take back the last edit (Ctrl+Z)", () => panel.push("undo"));
    this.redo = this.button("Redo", "Make it again (Ctrl+Shift+Z)", () => panel.push("redo"));
    this.save = this.button("Save", "Write a new version of the annotations", () => panel.push("save"));
    this.button("×", "Close the annotations; nothing is lost", () =>
      panel.app.options.push?.("annotation_close", {}),
    );
  }

  get height() {
    return this.el.offsetHeight;
  }

  part(tag, label) {
    const e = this.el.appendChild(document.createElement(tag));
    if (label) e.setAttribute("aria-label", label);
    return e;
  }

  button(text, title, run) {
    const b = this.part("button");
    Object.assign(b, { type: "button", textContent: text, title });
    b.addEventListener("click", run);
    return b;
  }

  field(label, type, changed) {
    const input = this.part("input", label);
    Object.assign(input, { type, title: label });
    input.addEventListener("change", () => {
      const item = this.panel.item();
      if (item) changed(input.value, item);
    });
    return input;
  }

  ask(event) {
    this.panel.app.options.push?.(event, {});
  }

  async name() {
    const said = await ask({ title: "Your name, for what you annotate here", value: annotator() ?? "" });
    if (!said) return;
    setAnnotator(said.text.trim().slice(0, 60));
    this.update();
  }

  update() {
    const { told, attribute } = this.panel;
    const item = this.panel.item();
    this.title.textContent = `${told.stream ?? ""}  ${told.items.length}`;
    this.attribute.hidden = told.attributes.length < 2;
    const names = told.attributes.map((a) => a.name).join("\n");
    if (names !== this.names) {
      this.names = names;
      this.attribute.textContent = "";
      for (const a of told.attributes)
        this.attribute.appendChild(document.createElement("option")).textContent = a.name;
    }
    this.attribute.selectedIndex = attribute;
    this.fill(told.attributes[attribute], item);
    // they keep their place, so that choosing an annotation moves nothing
    this.note.disabled = this.confidence.disabled = !item;
    if (!item) this.note.value = this.confidence.value = "";
    if (item && document.activeElement !== this.note) this.note.value = item.note ?? "";
    if (item && document.activeElement !== this.confidence) this.confidence.value = item.confidence ?? "";
    this.who.textContent = annotator() ? `as ${annotator()}` : "no name given";
    this.proposals(told, item);
    this.undo.disabled = !told.undo;
    this.redo.disabled = !told.redo;
    this.save.textContent = told.unsaved ? "Save •" : "Saved";
    this.save.disabled = !told.unsaved;
  }

  get least() {
    return Number(this.threshold.value);
  }

  // How many each button is about: the chosen proposal, those of the confidence, or all.
  proposals(told, item) {
    const all = told.items.filter((a) => a.proposed);
    this.accept.hidden = this.reject.hidden = !all.length;
    this.threshold.hidden = !all.some((a) => a.confidence != null);
    if (this.threshold.hidden) this.threshold.value = 0;
    const sure = all.filter((a) => (a.confidence ?? 1) >= this.least).length;
    const below = this.least > 0 ? all.length - sure : all.length;
    const one = item?.proposed;
    this.threshold.setAttribute("aria-valuetext", `${this.least}: ${sure} of ${all.length} proposals`);
    this.accept.textContent = one ? "Accept this" : `Accept ${sure}`;
    this.reject.textContent = one ? "Reject this" : `Reject ${below}`;
    this.accept.title = one
      ? "Accept the chosen proposal"
      : `Accept the proposals of at least confidence ${this.least}`;
    this.reject.title = one ? "Reject the chosen proposal" : "Reject the proposals below the confidence, or all";
    this.accept.disabled = !one && sure === 0;
    this.reject.disabled = !one && below === 0;
  }

  // The values: a click sets the chosen annotation's, or makes one of the selection.
  fill(attribute, item) {
    const key = JSON.stringify([attribute, item?.id, item?.values]);
    if (key === this.filled) return;
    this.filled = key;
    this.values.textContent = "";
    if (!attribute) return;
    if (attribute.kind === "finite") return attribute.values.forEach((v) => this.value(attribute, v, item));
    const input = this.values.appendChild(document.createElement("input"));
    input.type = attribute.kind === "bool" ? "checkbox" : "text";
    input.setAttribute("aria-label", attribute.name);
    input.title = input.placeholder = attribute.name;
    input.disabled = !item;
    if (attribute.kind === "bool") input.checked = item?.values[attribute.name] === true;
    else input.value = item?.values[attribute.name] ?? "";
    input.addEventListener("change", () => {
      const value =
        attribute.kind === "bool" ? input.checked : attribute.kind === "number" ? Number(input.value) : input.value;
      this.panel.push("value", { id: item.id, attribute: attribute.name, value });
    });
  }

  value(attribute, { value, fill, key }, item) {
    const b = this.values.appendChild(document.createElement("button"));
    b.type = "button";
    b.textContent = key ? `${value}  ${key}` : value;
    b.setAttribute("aria-pressed", String(item?.values[attribute.name] === value));
    if (fill) b.style.boxShadow = `inset 0 -3px ${fill}`;
    b.addEventListener("click", () => {
      const { sel } = this.panel.app.time.get();
      if (item) this.panel.push("value", { id: item.id, attribute: attribute.name, value });
      else if (sel[0] != null && sel[1] != null) this.panel.add(sel[0], sel[1], { [attribute.name]: value });
    });
  }

  async chooseTrack() {
    const { panel } = this;
    const old = panel.track;
    const said = await ask({
      title: "Track",
      value: old,
      choices: panel.tracks(),
      actions: [
        ["choose", "Choose or make"],
        ["rename", `Rename ${old}`],
        ["delete", `Delete ${old}`],
      ],
    });
    const name = said?.text.trim().slice(0, 60);
    if (!name) return;
    if (said.action === "delete") panel.push("delete_track", { track: old });
    else if (said.action === "rename" && name !== old) panel.push("rename_track", { track: old, name });
    if (said.action !== "delete") panel.track = name;
    panel.tell({ ...panel.raw });
  }

  settle(how) {
    const item = this.panel.item();
    if (item?.proposed) return this.panel.push(how === "accept" ? "accept" : "remove", { id: item.id });
    const { least } = this;
    this.panel.push(`${how}_all`, how === "reject" && least === 0 ? { all: true } : { least });
  }
}
