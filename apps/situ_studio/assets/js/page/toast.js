// A brief message at the bottom of the page.

const SHOWN = 4000;
let timer = 0;

export function showToast(text) {
  const el = document.getElementById("toast");
  if (!el) return;
  el.textContent = text;
  el.classList.add("on");
  clearTimeout(timer);
  timer = setTimeout(() => el.classList.remove("on"), SHOWN);
}

export async function copyText(text, done, refused = text) {
  try {
    await navigator.clipboard.writeText(text);
    showToast(done);
  } catch {
    showToast(refused);
  }
}
