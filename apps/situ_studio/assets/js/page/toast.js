// A sentence in passing, at the foot of the page.

const SHOWN = 4000;
let timer = null;

export function toast(text) {
  const el = document.getElementById("toast");
  if (!el) return;
  el.textContent = text;
  el.classList.add("on");
  clearTimeout(timer);
  timer = setTimeout(() => el.classList.remove("on"), SHOWN);
}

export async function copy(text, done, refused = text) {
  try {
    await navigator.clipboard.writeText(text);
    toast(done);
  } catch {
    toast(refused);
  }
}
