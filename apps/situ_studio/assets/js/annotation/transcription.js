// Transcription: the annotations of a track are rows with a text field. The row in use is played in a loop. Enter goes
// to the next row and Shift+Enter to the previous one, so the hands stay on the keyboard.

import { formatClock } from "../time/clock.js";
import { showToast } from "../page/toast.js";
import { listTranscriptRows } from "./tiers.js";
import { viewAround } from "./review.js";

// A point in time is played with this much around it, in ns.
const AROUND = 5e8;

export class Transcription {
  constructor(panel) {
    this.panel = panel;
    /** @type {HTMLElement | null} */
    this.box = null;
    this.at = 0;
    /** @type {string | null} */
    this.track = null;
  }

  get active() {
    return this.box !== null;
  }

  get time() {
    return this.panel.app.time;
  }

  get rows() {
    return listTranscriptRows(this.panel.state, this.track);
  }

  start() {
    this.track = this.panel.track;
    const { rows } = this;
    if (!rows.length) {
      showToast("There is nothing to transcribe: the track needs annotations with a text, or a tier of texts");
      return;
    }
    this.repeated = this.time.get().repeat;
    this.box = document.createElement("section");
    this.box.className = "transcription";
    this.box.setAttribute("aria-label", `Transcription of ${this.track}`);
    this.box.addEventListener("keydown", (e) => this.handleKeyDown(e));
    this.panel.el.closest(".annotation").after(this.box);
    this.draw(rows);
    const { cursor } = this.time.get();
    this.show(
      Math.max(
        rows.findIndex((r) => r.to >= cursor),
        0,
      ),
    );
    this.panel.tools.update();
  }

  stop() {
    if (!this.box) return;
    this.write();
    this.box.remove();
    this.box = null;
    this.time.dispatch({ type: "stop" });
    if (this.time.get().repeat !== this.repeated) this.time.dispatch({ type: "repeat" });
    this.panel.tools.update();
    this.panel.el.focus({ preventScroll: true });
  }

  draw(rows) {
    const { origin } = this.panel.app.client;
    const list = document.createElement("ol");
    rows.forEach((row, i) => {
      const li = list.appendChild(document.createElement("li"));
      const label = li.appendChild(document.createElement("label"));
      label.appendChild(document.createElement("span")).textContent = formatClock(row.from, origin);
      const input = label.appendChild(document.createElement("input"));
      Object.assign(input, { type: "text", value: row.text, autocomplete: "off" });
      input.addEventListener("focus", () => this.at !== i && this.show(i));
    });
    const hint = document.createElement("p");
    hint.className = "hint";
    hint.textContent =
      "Enter: next row, Shift+Enter: previous row, Ctrl+Space: stop or play, Ctrl+Enter: split here, Escape: end";
    this.box?.replaceChildren(list, hint);
  }

  inputs() {
    return [...(this.box?.querySelectorAll("input") ?? [])];
  }

  // Writes the text of the row in use, and goes to another row.
  show(i) {
    const { rows } = this;
    if (!rows[i]) return;
    this.write();
    this.at = i;
    const row = rows[i];
    const input = this.inputs()[i];
    if (document.activeElement !== input) input.focus({ preventScroll: true });
    input.closest("li")?.scrollIntoView({ block: "nearest" });
    for (const li of this.box?.querySelectorAll("li") ?? []) li.classList.toggle("now", li.contains(input));
    this.panel.selected = row.item?.id ?? null;
    const [from, to] = viewAround(row, this.time.get().view);
    this.time.dispatch({ type: "view", from, to });
    this.time.dispatch({ type: "select", from: row.from, to: row.to });
    this.play(row);
    this.panel.app.scheduleDraw(this.panel);
  }

  play({ from, to }) {
    const around = to > from ? 0 : AROUND;
    this.time.dispatch({ type: "play", from: from - around, to: to + around, repeat: true });
  }

  write() {
    const row = this.rows[this.at];
    const text = this.inputs()[this.at]?.value ?? "";
    if (!row || text === row.text) return;
    const { attribute, track, item } = row;
    if (item) this.panel.pushEdit("value", { id: item.id, attribute, value: text });
    else this.panel.addAnnotation(row.from, row.to, { [attribute]: text }, track);
  }

  handleKeyDown(e) {
    const { at } = this;
    const commands = {
      Escape: () => this.stop(),
      Enter: () => (e.ctrlKey ? this.split() : this.go(e.shiftKey ? at - 1 : at + 1)),
      ArrowDown: () => this.go(at + 1),
      ArrowUp: () => this.go(at - 1),
      " ": () => this.togglePlay(),
    };
    const run = commands[e.key];
    if (!run || (e.key === " " && !e.ctrlKey)) return e.stopPropagation();
    e.preventDefault();
    e.stopPropagation();
    run();
  }

  go(i) {
    const last = this.rows.length - 1;
    if (i > last) {
      this.write();
      return showToast("This was the last row");
    }
    this.show(Math.max(i, 0));
  }

  split() {
    const item = this.rows[this.at]?.item;
    if (!item) return;
    this.write();
    this.panel.pushEdit("split", { id: item.id, at: this.panel.app.client.toAbsolute(this.time.get().cursor) });
  }

  togglePlay() {
    const row = this.rows[this.at];
    if (this.time.get().mode === "play") this.time.dispatch({ type: "stop" });
    else if (row) this.play(row);
  }

  // Called when the server has sent the annotations. Texts that are being typed are kept.
  update() {
    if (!this.box) return;
    const { rows } = this;
    const inputs = this.inputs();
    if (rows.length !== inputs.length) {
      const typed = inputs[this.at]?.value;
      this.draw(rows);
      this.at = Math.min(this.at, rows.length - 1);
      const input = this.inputs()[this.at];
      if (!input) return this.stop();
      if (typed !== undefined && rows[this.at].text === "") input.value = typed;
      input.focus({ preventScroll: true });
      return;
    }
    rows.forEach((row, i) => {
      if (document.activeElement !== inputs[i]) inputs[i].value = row.text;
    });
  }
}
