// A list of commands and streams, searched by typing parts of their names.

import { listKeys } from "./keys.js";
import { placeEntries } from "./panel_commands.js";
import { closestTarget, findElement, getElement } from "./dom.js";

export class Palette {
  constructor(app) {
    this.app = app;
    this.dialog = getElement("palette", HTMLDialogElement);
    this.input = findElement(this.dialog, "input", HTMLInputElement);
    this.list = findElement(this.dialog, "ul");
    /** @type {{text: string, hint: string, run: () => void}[]} */
    this.shown = [];
    this.selected = 0;
    this.input.addEventListener("input", () => this.fillList());
    this.dialog.addEventListener("keydown", (e) => this.handleKey(e));
    this.list.addEventListener("click", (e) => {
      const i = [...this.list.children].findIndex((li) => li === closestTarget(e, "li"));
      if (i >= 0) this.runEntry(i);
    });
  }

  open() {
    this.input.value = "";
    this.selected = 0;
    this.fillList();
    this.dialog.showModal();
    this.input.focus();
  }

  listEntries() {
    let streams = [];
    try {
      streams = JSON.parse(document.getElementById("stream-names")?.dataset.names ?? "[]");
    } catch {
      // without stream names, only commands are offered
    }
    return [
      ...listKeys().map(([key, text, action]) => ({
        text,
        hint: key.replace("Arrow", ""),
        run: () => this.app.runAction(action),
      })),
      { text: "Copy link to this view", hint: "", run: () => this.app.runAction("copyLink") },
      { text: "Copy view-only link", hint: "", run: () => this.app.runAction("copyViewerLink") },
      { text: "Copy cursor time in ns", hint: "", run: () => this.app.runAction("copyNs") },
      { text: "Copy session and cursor time", hint: "", run: () => this.app.runAction("copyPlace") },
      ...placeEntries(this.app),
      ...streams.map((stream) => ({
        text: stream,
        hint: "add stream",
        run: () => this.app.options.push?.("add_stream", { stream, panel: "" }),
      })),
    ];
  }

  fillList() {
    this.shown = rankEntries(this.listEntries(), this.input.value).slice(0, 12);
    this.selected = 0;
    this.list.textContent = "";
    this.shown.forEach((entry, i) => {
      const li = this.list.appendChild(document.createElement("li"));
      li.setAttribute("role", "option");
      li.setAttribute("aria-selected", String(i === 0));
      li.appendChild(document.createElement("span")).textContent = entry.text;
      li.appendChild(document.createElement("kbd")).textContent = entry.hint;
    });
  }

  handleKey(e) {
    const n = this.shown.length;
    if (e.key === "ArrowDown" || e.key === "ArrowUp") {
      this.selected = (this.selected + (e.key === "ArrowDown" ? 1 : n - 1)) % Math.max(n, 1);
      [...this.list.children].forEach((li, i) => li.setAttribute("aria-selected", String(i === this.selected)));
      e.preventDefault();
    } else if (e.key === "Enter") {
      e.preventDefault();
      this.runEntry(this.selected);
    }
  }

  runEntry(i) {
    this.dialog.close();
    this.shown[i]?.run();
  }
}

// Ranks entries: every typed word must occur, or its letters in order. Earlier and tighter matches come first.
export function rankEntries(entries, query) {
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  return entries
    .map((entry, i) => ({ entry, i, score: scoreMatch(entry.text.toLowerCase(), words) }))
    .filter((x) => x.score !== null)
    .sort((a, b) => a.score - b.score || a.i - b.i)
    .map((x) => x.entry);
}

function scoreMatch(text, words) {
  let total = 0;
  for (const w of words) {
    const at = text.indexOf(w);
    if (at >= 0) {
      total += at;
      continue;
    }
    let p = -1,
      first = -1;
    for (const c of w) {
      p = text.indexOf(c, p + 1);
      if (p < 0) return null;
      if (first < 0) first = p;
    }
    total += 100 + (p - first);
  }
  return total;
}
