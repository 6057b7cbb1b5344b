// The toolbar of the annotation panel: the shown attribute, the value of the selected annotation, tracks, proposals,
// undo and save.

import { askText } from "../page/questions.js";
import { readAnnotator, setAnnotator } from "./annotator.js";
import { agreementText } from "./merged.js";
import { REVIEW_KEYS, progressText } from "./review.js";
import { SEGMENTATIONS } from "./segmentation.js";
import { findTier } from "./tiers.js";

export class Tools {
  constructor(el, panel) {
    this.panel = panel;
    this.el = el.appendChild(document.createElement("div"));
    this.el.className = "annotation-tools";
    this.title = this.addElement("b");
    this.attribute = this.addElement("select", "Attribute");
    this.attribute.addEventListener("change", () => {
      panel.attribute = this.attribute.selectedIndex;
      panel.app.scheduleDraw(panel);
      this.update();
    });
    this.values = this.addElement("span");
    this.note = this.addField("Note", "text", (note, item) => panel.pushEdit("note", { id: item.id, note }));
    this.confidence = this.addField("Confidence, 0 to 1", "number", (text, item) =>
      panel.pushEdit("confidence", { id: item.id, confidence: text === "" ? null : Number(text) }),
    );
    Object.assign(this.confidence, { min: 0, max: 1, step: 0.05, placeholder: "confidence" });
    this.note.placeholder = "note";
    this.track = this.addButton("Track…", "Switch to another track, create one, or rename this one", () =>
      this.chooseTrack(),
    );
    this.addButton("Schema…", "Edit attributes, values, keys and colors", () => this.pushEvent("annotation_schema"));
    this.addButton("Tiers…", "Add, rename, move and remove tiers, and change their values", () =>
      this.pushEvent("annotation_tiers"),
    );
    this.addButton("History…", "Show who changed these annotations, and restore earlier versions", () =>
      this.pushEvent("annotation_history"),
    );
    this.addButton("Agreement…", "Compare this layer with another", () => this.pushEvent("annotation_streams"));
    this.segment = this.addButton(
      "",
      "Make annotations by pressing Enter at their boundaries during playback (g)",
      () => panel.segmentation.switchMode(),
    );
    this.transcribe = this.addButton("Transcribe", "Type the texts row by row while each is played (T)", () =>
      panel.transcription.active ? panel.transcription.stop() : panel.transcription.start(),
    );
    this.merged = this.addButton("All annotators", "Show the layers of all annotators, and where they agree", () =>
      panel.merged.toggle(),
    );
    this.agreement = this.addElement("i");
    this.agreement.setAttribute("role", "status");
    this.agreement.title = "d and D go to the next and previous disagreement";
    this.consensus = this.addButton(
      "Consensus",
      "Create a layer with all agreements, and with proposals where the annotators disagree",
      () => this.pushEvent("annotation_consensus"),
    );
    this.who = this.addButton("", "Annotator name stored with new annotations", () => this.askName());
    this.review = this.addButton("Review", "Review the proposals one by one (q)", () =>
      panel.review.active ? panel.review.stop() : panel.review.start(),
    );
    this.progress = this.addElement("i");
    this.progress.className = "progress";
    this.progress.setAttribute("role", "status");
    this.hint = this.addElement("small");
    // proposals at or above this confidence are accepted, the others rejected; the panel shows the effect while it
    // moves
    this.threshold = this.addElement("input", "Minimum confidence of accepted proposals");
    Object.assign(this.threshold, { type: "range", min: 0, max: 1, step: 0.01, value: 0 });
    this.threshold.title = "Minimum confidence of accepted proposals";
    this.threshold.addEventListener("input", () => {
      this.update();
      panel.app.scheduleDraw(panel);
    });
    this.accept = this.addButton("Accept", "", () => this.settleProposals("accept"));
    this.reject = this.addButton("Reject", "", () => this.settleProposals("reject"));
    this.undo = this.addButton("Undo", "Undo the last edit (Ctrl+Z)", () => panel.pushEdit("undo"));
    this.redo = this.addButton("Redo", "Redo the edit (Ctrl+Shift+Z)", () => panel.pushEdit("redo"));
    this.save = this.addButton("Save", "Save a new version of the annotations", () => panel.pushEdit("save"));
    this.addButton("×", "Close the annotations; unsaved edits are kept", () =>
      panel.app.options.push?.("annotation_close", {}),
    );
  }

  get height() {
    return this.el.offsetHeight;
  }

  addElement(tag, label) {
    const e = this.el.appendChild(document.createElement(tag));
    if (label) e.setAttribute("aria-label", label);
    return e;
  }

  addButton(text, title, run) {
    const b = this.addElement("button");
    Object.assign(b, { type: "button", textContent: text, title });
    b.addEventListener("click", run);
    return b;
  }

  addField(label, type, changed) {
    const input = this.addElement("input", label);
    Object.assign(input, { type, title: label });
    input.addEventListener("change", () => {
      const item = this.panel.findItem();
      if (item) changed(input.value, item);
    });
    return input;
  }

  pushEvent(event) {
    this.panel.app.options.push?.(event, {});
  }

  async askName() {
    const said = await askText({ title: "Your name, stored with your annotations", value: readAnnotator() ?? "" });
    if (!said) return;
    setAnnotator(said.text.trim().slice(0, 60));
    this.update();
  }

  update() {
    const { state } = this.panel;
    const item = this.panel.findItem();
    const tier = findTier(state.tiers, this.panel.track);
    if (tier) this.panel.attribute = state.attributes.findIndex((a) => a.name === tier.attribute);
    const { attribute } = this.panel;
    const { mode } = this.panel.segmentation.marks;
    this.segment.textContent = SEGMENTATIONS.find(([name]) => name === mode)?.[1] ?? "";
    this.segment.setAttribute("aria-pressed", String(mode !== "off"));
    this.segment.hidden = this.panel.spatial.kind != null;
    const { merged } = this.panel;
    this.merged.setAttribute("aria-pressed", String(merged.active));
    this.agreement.textContent = merged.active ? agreementText(merged.data) : "";
    this.consensus.hidden = !merged.active;
    this.transcribe.hidden = !state.attributes.some((a) => a.kind === "text");
    this.transcribe.setAttribute("aria-pressed", String(this.panel.transcription.active));
    this.title.textContent = `${state.stream ?? ""}  ${state.items.length}`;
    this.attribute.hidden = state.attributes.length < 2 || tier != null;
    const names = state.attributes.map((a) => a.name).join("\n");
    if (names !== this.names) {
      this.names = names;
      this.attribute.textContent = "";
      for (const a of state.attributes)
        this.attribute.appendChild(document.createElement("option")).textContent = a.name;
    }
    this.attribute.selectedIndex = attribute;
    this.fillValues(state.attributes[attribute], item);
    // they are disabled instead of hidden, so that selecting an annotation moves nothing
    this.note.disabled = this.confidence.disabled = !item;
    if (!item) this.note.value = this.confidence.value = "";
    if (item && document.activeElement !== this.note) this.note.value = item.note ?? "";
    if (item && document.activeElement !== this.confidence) this.confidence.value = item.confidence ?? "";
    this.who.textContent = readAnnotator() ? `as ${readAnnotator()}` : "no name";
    this.updateProposals(state, item);
    this.undo.disabled = !state.undo;
    this.redo.disabled = !state.redo;
    this.save.textContent = state.unsaved ? "Save •" : "Saved";
    this.save.disabled = !state.unsaved;
  }

  get minConfidence() {
    return Number(this.threshold.value);
  }

  // Labels the buttons with what they affect: the selected proposal, the proposals by confidence, or all of them.
  updateProposals(state, item) {
    const all = state.items.filter((a) => a.proposed);
    this.accept.hidden = this.reject.hidden = this.review.hidden = !all.length;
    this.review.textContent = this.panel.review.active ? "End review" : "Review";
    this.progress.textContent = progressText(state.review);
    this.hint.textContent = this.panel.review.active ? REVIEW_KEYS : "";
    this.threshold.hidden = !all.some((a) => a.confidence != null);
    if (this.threshold.hidden) this.threshold.value = 0;
    const sure = all.filter((a) => (a.confidence ?? 1) >= this.minConfidence).length;
    const below = this.minConfidence > 0 ? all.length - sure : all.length;
    const one = item?.proposed;
    this.threshold.setAttribute("aria-valuetext", `${this.minConfidence}: ${sure} of ${all.length} proposals`);
    this.accept.textContent = one ? "Accept this" : `Accept ${sure}`;
    this.reject.textContent = one ? "Reject this" : `Reject ${below}`;
    this.accept.title = one
      ? "Accept the selected proposal"
      : `Accept the proposals with a confidence of at least ${this.minConfidence}`;
    this.reject.title = one
      ? "Reject the selected proposal"
      : "Reject the proposals below this confidence, or all of them";
    this.accept.disabled = !one && sure === 0;
    this.reject.disabled = !one && below === 0;
  }

  // Shows the values. A click sets the value of the selected annotation, or annotates the selection with it.
  fillValues(attribute, item) {
    const key = JSON.stringify([attribute, item?.id, item?.values]);
    if (key === this.filled) return;
    this.filled = key;
    this.values.textContent = "";
    if (!attribute) return;
    if (attribute.kind === "finite") return attribute.values.forEach((v) => this.addValueButton(attribute, v, item));
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
      this.panel.pushEdit("value", { id: item.id, attribute: attribute.name, value });
    });
  }

  addValueButton(attribute, { value, fill, key }, item) {
    const b = this.values.appendChild(document.createElement("button"));
    b.type = "button";
    b.textContent = key ? `${value}  ${key}` : value;
    b.setAttribute("aria-pressed", String(item?.values[attribute.name] === value));
    if (fill) b.style.boxShadow = `inset 0 -3px ${fill}`;
    b.addEventListener("click", () => {
      const { sel } = this.panel.app.time.get();
      if (item) this.panel.pushEdit("value", { id: item.id, attribute: attribute.name, value });
      else if (sel[0] != null && sel[1] != null)
        this.panel.addAnnotation(sel[0], sel[1], { [attribute.name]: value });
    });
  }

  async chooseTrack() {
    const { panel } = this;
    const old = panel.track;
    const said = await askText({
      title: "Track",
      value: old,
      choices: panel.trackNames(),
      actions: [
        ["choose", "Choose or create"],
        ["rename", `Rename ${old}`],
        ["delete", `Delete ${old}`],
      ],
    });
    const name = said?.text.trim().slice(0, 60);
    if (!name) return;
    if (said.action === "delete") panel.pushEdit("delete_track", { track: old });
    else if (said.action === "rename" && name !== old) panel.pushEdit("rename_track", { track: old, name });
    if (said.action !== "delete") panel.track = name;
    panel.applyUpdate({ ...panel.raw });
  }

  settleProposals(how) {
    const item = this.panel.findItem();
    if (item?.proposed) return this.panel.pushEdit(how === "accept" ? "accept" : "remove", { id: item.id });
    const { minConfidence: least } = this;
    this.panel.pushEdit(`${how}_all`, how === "reject" && least === 0 ? { all: true } : { least });
  }
}
