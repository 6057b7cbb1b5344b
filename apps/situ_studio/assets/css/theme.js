// Sets the theme before the first paint, so that nothing flashes: the last chosen theme, or the system's.
(function () {
  /** @type {string | null} */
  let chosen = null;
  try {
    chosen = localStorage.getItem("situ:theme");
  } catch {
    // no storage: the system's theme
  }
  if (chosen !== "light" && chosen !== "dark") {
    chosen = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  }
  document.documentElement.dataset.theme = chosen;
  try {
    document.documentElement.dataset.palette =
      JSON.parse(localStorage.getItem("situ:settings") || "{}").palette || "usual";
  } catch {
    // the default colors
  }
})();

// Restores the column widths that the user chose.
["--left", "--right"].forEach(function (name) {
  try {
    const px = localStorage.getItem("situ:" + name);
    if (px) document.documentElement.style.setProperty(name, px + "px");
  } catch {
    // no storage: the default widths
  }
});

// The browser shows the page when its end has arrived, so that nothing moves while it loads. The page's own address is
// needed, because "#page-end" alone would be resolved against <base>.
(function () {
  const link = document.createElement("link");
  link.rel = "expect";
  link.href = location.href.split("#")[0] + "#page-end";
  link.setAttribute("blocking", "render");
  document.head.append(link);
})();
