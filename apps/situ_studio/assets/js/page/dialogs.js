// The dialogs of the page: go to a time, and the sheet of keys.

import { keys } from "./keys.js";
import { duration, parseTime } from "../time/text.js";
import { parseClock } from "../time/clock.js";

const byId = (id) => document.getElementById(id);

// origin() -> the first time of the data as a BigInt, or null
export function listenGoto(time, origin) {
  byId("goto")?.addEventListener("submit", (e) => {
    e.preventDefault();
    const dialog = e.currentTarget;
    const error = dialog.querySelector(".error");
    const text = dialog.querySelector("input").value;
    const t = parseClock(text, origin() ?? 0n) ?? parseTime(text, origin() ?? 0n);
    const [from, to] = time.get().data;
    if (t == null) error.textContent = "Not a time. Try 1:23.5, 83.5 s, 250 ms or 2026-01-31T12:34:56Z";
    else if (t < from || t > to) error.textContent = `Outside of the data, which lasts from 0 to ${duration(to)}`;
    else {
      dialog.close();
      time.dispatch({ type: "goto", t });
    }
  });
}

export function openGoto() {
  const dialog = byId("goto");
  const input = dialog.querySelector("input");
  input.value = "";
  dialog.querySelector(".error").textContent = "";
  dialog.showModal();
  input.focus();
}

export function openHelp() {
  const dialog = byId("help");
  const list = dialog.querySelector("dl");
  list.textContent = "";
  for (const [key, text] of keys()) {
    list.appendChild(document.createElement("dt")).textContent = key.replace("Arrow", "");
    list.appendChild(document.createElement("dd")).textContent = text;
  }
  dialog.showModal();
}
