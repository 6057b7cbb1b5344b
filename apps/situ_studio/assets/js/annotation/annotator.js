// Who annotates in this browser: what is made bears the name.

const KEY = "situ:annotator";

export function annotator() {
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
    // private windows may have no storage: nobody's name then stands in what is made
  }
}

// The dialog's fields hold the name, and give it.
export function rememberAnnotator(root) {
  for (const input of root.querySelectorAll("#annotation-own input[name=by]")) input.value ||= annotator() ?? "";
  root.addEventListener("submit", (e) => {
    const by = e.target.querySelector("input[name=by]")?.value.trim();
    if (by) setAnnotator(by);
  });
}
