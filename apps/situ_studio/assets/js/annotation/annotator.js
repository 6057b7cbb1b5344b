// Stores the name of the person who annotates in this browser. New annotations carry it.

const KEY = "situ:annotator";

export function readAnnotator() {
  try {
    return localStorage.getItem(KEY) || null;
  } catch {
    return null;
  }
}

export function setAnnotator(name) {
  try {
    if (name) localStorage.setItem(KEY, name);
    else localStorage.removeItem(KEY);
  } catch {
    // private windows may have no storage; annotations then carry no name
  }
}

// Fills the name field of a dialog, and stores the name when the dialog is submitted.
export function rememberAnnotator(root) {
  for (const input of root.querySelectorAll("#annotation-own input[name=by]")) input.value ||= readAnnotator() ?? "";
  root.addEventListener("submit", (e) => {
    const by = e.target.querySelector("input[name=by]")?.value.trim();
    if (by) setAnnotator(by);
  });
}
