// The dialogs of the page: "go to time" and the key help.

import { listKeys } from "./keys.js";
import { formatDuration, parseTime } from "../time/text.js";
import { parseClock } from "../time/clock.js";
import { findElement, getElement } from "./dom.js";

// `client` has the first time of the data (`origin`, a BigInt or null) and converts to absolute times.
export function listenGoto(time, client) {
  document.getElementById("goto")?.addEventListener("submit", (e) => {
    e.preventDefault();
    const { dialog, input, error } = gotoElements();
    const { session, text } = splitSessionTime(input.value);
    const origin = client.origin ?? 0n;
    const t = parseClock(text, origin) ?? parseTime(text, origin);
    const [from, to] = time.get().data;
    const other =
      session !== null && session !== sessionTitle() ? listSessions().find(([name]) => name === session) : null;
    if (session !== null && session !== sessionTitle() && !other)
      error.textContent = `There is no session “${session}” in this list`;
    else if (t == null) error.textContent = "Not a time. Try 1:23.5, 83.5 s, 250 ms or 2026-01-31T12:34:56Z";
    else if (other && !/^(\d{4}-|\d{15})/.test(text))
      error.textContent = "For another session, enter a date and time or nanoseconds";
    else if (other) location.assign(withTime(other[1], client.toAbsolute(t)));
    else if (t < from || t > to) error.textContent = `Outside the data, which ranges from 0 to ${formatDuration(to)}`;
    else {
      dialog.close();
      time.dispatch({ type: "goto", t });
    }
  });
}

// Splits "session@time"; a time without a session refers to the current one.
export function splitSessionTime(text) {
  const at = text.lastIndexOf("@");
  return at < 0
    ? { session: null, text: text.trim() }
    : { session: text.slice(0, at).trim(), text: text.slice(at + 1).trim() };
}

export const sessionTitle = () => document.querySelector("h1.where")?.textContent.trim() ?? "";

/** @returns {[name: string, href: string][]} */
const listSessions = () =>
  [.../** @type {NodeListOf<HTMLAnchorElement>} */ (document.querySelectorAll("a.store"))].map((a) => [
    a.textContent.trim(),
    a.href,
  ]);

function withTime(href, ns) {
  const url = new URL(href);
  url.searchParams.set("at", ns);
  url.searchParams.set("held", "1");
  return url.href;
}

function gotoElements() {
  const dialog = getElement("goto", HTMLDialogElement);
  return { dialog, input: findElement(dialog, "input", HTMLInputElement), error: findElement(dialog, ".error") };
}

export function openGoto() {
  const { dialog, input, error } = gotoElements();
  input.value = "";
  error.textContent = "";
  dialog.showModal();
  input.focus();
}

export function openHelp(app) {
  const dialog = getElement("help", HTMLDialogElement);
  const list = findElement(dialog, "dl");
  list.textContent = "";
  for (const [key, text, action] of listKeys()) {
    if (!app.allows(action)) continue;
    list.appendChild(document.createElement("dt")).textContent = key.replace("Arrow", "");
    list.appendChild(document.createElement("dd")).textContent = text;
  }
  dialog.showModal();
}
