// A tooltip next to the mouse that describes what is under it. There is one for the page.

const GAP = 14;
/** @type {HTMLElement | null} */
let el = null;
let owner = null;

// Shows `lines` for `who` next to a position in the window. Without lines it is hidden, if `who` still owns it.
export function showTip(who, lines, x = 0, y = 0) {
  if (!lines.length) {
    if (owner === who && el) el.hidden = true;
    return;
  }
  if (!el?.isConnected) {
    el = document.body.appendChild(document.createElement("div"));
    el.id = "tip";
    el.setAttribute("role", "tooltip");
  }
  owner = who;
  el.hidden = false;
  const text = lines.join("\n");
  if (el.textContent !== text) el.textContent = text;
  const { offsetWidth: w, offsetHeight: h } = el;
  const left = x + GAP + w > innerWidth ? x - GAP - w : x + GAP;
  const top = y + GAP + h > innerHeight ? y - GAP - h : y + GAP;
  el.style.transform = `translate(${Math.max(left, 0)}px, ${Math.max(top, 0)}px)`;
}
