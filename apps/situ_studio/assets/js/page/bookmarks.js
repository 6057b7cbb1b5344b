// The bookmarks of a recording, which the server stores: they are added by key, marked on the navigator, listed next to
// the panels, and visited one after the other.

import { readAnnotator } from "../annotation/annotator.js";
import { formatClock } from "../time/clock.js";
import { pushEvent } from "./channel.js";
import { askText } from "./questions.js";
import { showToast } from "./toast.js";

/** @typedef {{id: string, from: string, to: string, text: string, by: string, list: string}} Bookmark */

/** @type {Bookmark[]} the listed bookmarks by time */
let items = [];

// Returns the bookmark before or after a time, or null. A bookmark at the time itself is neither.
/**
 * @template {{from: number}} T
 * @param {T[]} sorted
 * @param {number} time
 * @param {1 | -1} way
 */
export function neighbour(sorted, time, way) {
  const found = way > 0 ? sorted.find((b) => b.from > time + 0.5) : sorted.findLast((b) => b.from < time - 0.5);
  return found ?? null;
}

// Returns the bookmarks with times relative to the start of the data.
export function listBookmarks(app) {
  if (app.client.origin === null) return [];
  const relative = (t) => app.client.toRelative(BigInt(t));
  return items.map((b) => ({ ...b, from: relative(b.from), to: relative(b.to) }));
}

function goTo(app, { from, to }) {
  if (to > from) app.time.dispatch({ type: "select", from, to });
  app.time.dispatch({ type: "nudge", by: from - app.time.get().cursor });
}

function step(app, way) {
  const found = neighbour(listBookmarks(app), app.time.get().cursor, way);
  if (!found) return showToast(way > 0 ? "No later bookmark" : "No earlier bookmark");
  goTo(app, found);
  showToast(found.text || "(no comment)");
}

// Asks for the comment and the list of a bookmark: {text, list}, or null.
async function askComment(title, { text = "", list = "" }) {
  const said = await askText({
    title: `${title} (end it with #name to put it in a list)`,
    value: list ? `${text} #${list}` : text,
    choices: [...new Set(items.map((b) => b.list))].filter(Boolean).map((name) => `#${name}`),
  });
  return said && splitList(said.text);
}

// "wheel is stuck #repairs" is the comment "wheel is stuck" in the list "repairs".
export function splitList(said) {
  const [, text, list] = /^(.*?)(?:(?:^|\s)#(\S[^#]*))?$/s.exec(said.trim()) ?? ["", said, ""];
  return { text: text.trim(), list: (list ?? "").trim() };
}

export const bookmarkCommands = {
  async bookmark(app) {
    if (app.client.origin === null) return;
    const { sel, cursor } = app.time.get();
    const both = sel[0] != null && sel[1] != null;
    const said = await askComment(both ? "Mark the selection" : "Mark this time", {});
    if (!said) return;
    const [from, to] = (both ? sel : [cursor, cursor]).map((t) => app.client.toAbsolute(t));
    const { list, ...rest } = said;
    pushEvent("bookmark_add", { from, to, ...rest, ...(list ? { list } : {}), by: readAnnotator() });
  },
  bookmarks: () => pushEvent("bookmark_toggle", {}),
  nextBookmark: (app) => step(app, 1),
  previousBookmark: (app) => step(app, -1),
};

export const hooks = {
  Bookmarks: {
    mounted() {
      this.onClick = (e) => this.handleClick(e);
      document.addEventListener("click", this.onClick);
      this.updated();
    },
    updated() {
      items = JSON.parse(this.el.dataset.items);
      const app = window.situStudio;
      requestAnimationFrame(() => this.showTimes());
      if (app) for (const v of app.views) if (v.navigator) app.scheduleDraw(v);
    },
    // Times are shown like those of the ruler; the origin of the data arrives later than the page.
    showTimes() {
      const { origin } = window.situStudio?.client ?? { origin: null };
      if (origin === null) return setTimeout(() => this.el.isConnected && this.showTimes(), 200);
      for (const el of document.querySelectorAll(".bookmark-items time")) {
        const from = window.situStudio?.client.toRelative(BigInt(el.getAttribute("data-from") ?? 0));
        el.textContent = formatClock(from, origin);
      }
    },
    async handleClick(e) {
      const go = e.target.closest?.("[data-go]");
      const change = e.target.closest?.("[data-change]");
      const app = window.situStudio;
      if (!app || !(go || change)) return;
      const found = listBookmarks(app).find((b) => b.id === (go?.dataset.go ?? change.dataset.change));
      if (!found) return;
      if (go) return goTo(app, found);
      const said = await askComment("Change the bookmark", found);
      if (said) pushEvent("bookmark_change", { id: found.id, ...said });
    },
    destroyed() {
      document.removeEventListener("click", this.onClick);
      items = [];
    },
  },
};
