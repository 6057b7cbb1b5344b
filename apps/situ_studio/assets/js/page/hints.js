// Five hints on the first recording that a browser opens. They are shown once.

const KEY = "situ:hints-seen";

const HINTS = [
  ["Move the mouse over a timeline", "to see that time in every panel"],
  ["Turn the wheel, or drag", "to zoom and to pan"],
  ["Press Space", "to play, with audio if there is any"],
  ["Drag a stream from the list", "to a panel, or next to one"],
  ["Press ? or Ctrl+K", "for all keys, and for all commands and streams"],
];

export function showHintsOnce() {
  if (wereSeen() || !matchMedia("(pointer: fine)").matches) return;
  const box = document.createElement("aside");
  box.id = "hints";
  box.setAttribute("aria-label", "Hints");
  const list = box.appendChild(document.createElement("ul"));
  for (const [what, effect] of HINTS) {
    const line = list.appendChild(document.createElement("li"));
    line.appendChild(document.createElement("b")).textContent = what;
    line.append(` ${effect}`);
  }
  const button = box.appendChild(document.createElement("button"));
  button.className = "btn primary";
  button.type = "button";
  button.textContent = "Got it";
  button.onclick = () => {
    box.remove();
    rememberSeen();
  };
  document.body.append(box);
}

// A browser without storage would show the hints on every page, so it shows none.
function wereSeen() {
  try {
    return localStorage.getItem(KEY) !== null;
  } catch {
    return true;
  }
}

function rememberSeen() {
  try {
    localStorage.setItem(KEY, "yes");
  } catch {
    // not remembered
  }
}
