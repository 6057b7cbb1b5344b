// The recordings and datasets that were looked at last in this browser, for the list and for who wants to begin there.

import { setting } from "./settings.js";

const KEY = "situ:recent",
  BEGUN = "situ:begun",
  MOST = 10;

export function recent() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "[]");
    return Array.isArray(found)
      ? found.filter((r) => typeof r?.path === "string" && typeof r?.title === "string")
      : [];
  } catch {
    return [];
  }
}

function keep(list) {
  try {
    localStorage.setItem(KEY, JSON.stringify(list.slice(0, MOST)));
  } catch {
    // private windows may have no storage
  }
}

// Of a page that shows something: it is the newest.
export function remember({ pathname: path } = location, title = document.title.replace(/ - Situ Studio$/, "")) {
  begun();
  keep([{ path, title }, ...recent().filter((r) => r.path !== path)]);
}

// Whether this tab has shown a page of the studio before; from now on it has.
function begun() {
  try {
    const before = sessionStorage.getItem(BEGUN) !== null;
    sessionStorage.setItem(BEGUN, "1");
    return before;
  } catch {
    return true;
  }
}

// Those that the list still has; a session is there as long as its dataset is.
export const among = (all, paths) =>
  all.filter(({ path }) => paths.some((p) => p === path || path.startsWith(`${p.replace("/d/", "/s/")}/`)));

// Into an element of the list, which leads to the newest at once where the settings say so.
export function showRecent(el) {
  const links = [...document.querySelectorAll(".home .list a.item")];
  const whole = !document.querySelector(".home .more");
  const found = whole
    ? among(
        recent(),
        links.map((a) => new URL(a.href).pathname),
      )
    : recent();
  keep(found);
  const first = !begun();
  if (first && setting("first") === "last" && found.length) return location.replace(found[0].path);
  el.hidden = found.length === 0;
  el.textContent = found.length ? "Looked at last: " : "";
  for (const { path, title } of found) {
    const a = el.appendChild(document.createElement("a"));
    a.href = path;
    a.textContent = title;
  }
}
