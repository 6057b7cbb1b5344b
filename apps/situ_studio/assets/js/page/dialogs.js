// The dialogs of the page: go to a time, and the sheet of keys.

import { keys } from "./keys.js";
import { duration, parseTime } from "../time/text.js";
import { parseClock } from "../time/clock.js";

const byId = (id) => document.getElementById(id);

// `client` knows the first time of the data (`origin`, a BigInt or null) and absolute times.
export function listenGoto(time, client) {
  byId("goto")?.addEventListener("submit", (e) => {
    e.preventDefault();
    const dialog = e.currentTarget;
    const error = dialog.querySelector(".error");
    const { session, text } = splitPlace(dialog.querySelector("input").value);
    const origin = client.origin ?? 0n;
    const t = parseClock(text, origin) ?? parseTime(text, origin);
    const [from, to] = time.get().data;
    const other = session !== null && session !== title() ? sessions().find(([name]) => name === session) : null;
    if (session !== null && session !== title() && !other)
      error.textContent = `There is no session “${session}” here`;
    else if (t == null) error.textContent = "Not a time. Try 1:23.5, 83.5 s, 250 ms or 2026-01-31T12:34:56Z";
    else if (other && !/^(\d{4}-|\d{15})/.test(text))
      error.textContent = "In another session only a date with a time, or nanoseconds, name a time";
    else if (other) location.assign(withTime(other[1], client.abs(t)));
    else if (t < from || t > to) error.textContent = `Outside of the data, which lasts from 0 to ${duration(to)}`;
    else {
      dialog.close();
      time.dispatch({ type: "goto", t });
    }
  });
}

// "session@time" as people copy it; a time alone is one of the session that is shown.
export function splitPlace(text) {
  const at = text.lastIndexOf("@");
  return at < 0
    ? { session: null, text: text.trim() }
    : { session: text.slice(0, at).trim(), text: text.slice(at + 1).trim() };
}

export const title = () => document.querySelector("h1.where")?.textContent.trim() ?? "";

const sessions = () => [...document.querySelectorAll("a.store")].map((a) => [a.textContent.trim(), a.href]);

function withTime(href, ns) {
  const url = new URL(href);
  url.searchParams.set("at", ns);
  url.searchParams.set("held", "1");
  return url.href;
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
