// Moves between the sessions of a dataset. The layout, the layer and the times since the start of the data are kept.

import { encodeSession } from "../time/link.js";
import { showToast } from "./toast.js";

const KEY = "situ:session ";

// Returns the part of this page's address that another session of the dataset can use.
function encodeView(app) {
  return encodeSession(app.time.get(), { ...app.options, snap: app.client.snap });
}

const datasetOf = (app) => app.root.dataset.dataset;

// Remembers the view of this session in this tab, for the dataset's page.
export function rememberSession(app) {
  if (!datasetOf(app) || app.client.origin === null) return;
  try {
    sessionStorage.setItem(KEY + datasetOf(app), encodeView(app));
  } catch {
    // private windows may have no storage; sessions then open with their own view
  }
}

// Returns the view of the session of a dataset that this tab showed last, as the query of an address, or "".
export function recallSession(dataset) {
  try {
    return sessionStorage.getItem(KEY + dataset) ?? "";
  } catch {
    return "";
  }
}

// Returns the address of a session's page that keeps a view.
export const withView = (href, query) => (query ? `${href}?${query}` : href);

export function openSession(app, href) {
  location.assign(withView(href, app.client.origin === null ? "" : encodeView(app)));
}

// Opens the next (by = 1) or previous (by = -1) session of the dataset.
export function stepSession(app, by) {
  const links = [...app.root.querySelectorAll("a.store[data-session]")];
  const at = links.findIndex((a) => a.dataset.session === app.options.source);
  if (at < 0) return showToast("This recording is not a session of a dataset");
  const next = links[at + by];
  if (!next) return showToast(by > 0 ? "This is the last session" : "This is the first session");
  openSession(app, next.getAttribute("href"));
}
