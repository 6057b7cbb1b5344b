// Stores the recently viewed recordings and datasets of this browser, for the list and for opening the last one on
// start.

import { readSetting } from "./settings.js";

const KEY = "situ:recent",
  BEGUN = "situ:begun",
  MOST = 10;

export function listRecent() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "[]");
    return Array.isArray(found)
      ? found.filter((r) => typeof r?.path === "string" && typeof r?.title === "string")
      : [];
  } catch {
    return [];
  }
}

function storeRecent(list) {
  try {
    localStorage.setItem(KEY, JSON.stringify(list.slice(0, MOST)));
  } catch {
    // private windows may have no storage
  }
}

// Puts the current page first.
export function rememberPage({ pathname: path } = location, title = document.title.replace(/ - Situ Studio$/, "")) {
  markTabBegun();
  storeRecent([{ path, title }, ...listRecent().filter((r) => r.path !== path)]);
}

// Returns true if this tab has shown a page of the studio before, and marks that it has.
function markTabBegun() {
  try {
    const before = sessionStorage.getItem(BEGUN) !== null;
    sessionStorage.setItem(BEGUN, "1");
    return before;
  } catch {
    return true;
  }
}

// Returns the entries that still exist; a session exists as long as its dataset does.
export const keepExisting = (all, paths) =>
  all.filter(({ path }) => paths.some((p) => p === path || path.startsWith(`${p.replace("/d/", "/s/")}/`)));

// Shows the recent pages in an element of the list, or opens the latest one if the settings say so.
export function showRecent(el) {
  /** @type {NodeListOf<HTMLAnchorElement>} */
  const links = document.querySelectorAll(".home .list a.item");
  const whole = !document.querySelector(".home .more");
  const found = whole
    ? keepExisting(
        listRecent(),
        Array.from(links, (a) => new URL(a.href).pathname),
      )
    : listRecent();
  storeRecent(found);
  const first = !markTabBegun();
  if (first && readSetting("first") === "last" && found.length) return location.replace(found[0].path);
  el.hidden = found.length === 0;
  el.textContent = found.length ? "Recently viewed: " : "";
  for (const { path, title } of found) {
    const a = el.appendChild(document.createElement("a"));
    a.href = path;
    a.textContent = title;
  }
}
