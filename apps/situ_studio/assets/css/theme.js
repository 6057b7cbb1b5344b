// Before the first paint: the theme chosen last, or the one the system prefers, so that nothing flashes.
(function () {
  var chosen = null;
  try {
    chosen = localStorage.getItem("situ:theme");
  } catch (e) {
    // no storage: the system's theme
  }
  if (chosen !== "light" && chosen !== "dark") {
    chosen = window.matchMedia && matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  }
  document.documentElement.dataset.theme = chosen;
  try {
    document.documentElement.dataset.palette = JSON.parse(localStorage.getItem("situ:settings")).palette || "usual";
  } catch (e) {
    // the usual colours
  }
})();

// The widths that columns were dragged to.
["--left", "--right", "--side"].forEach(function (name) {
  try {
    var px = localStorage.getItem("situ:" + name);
    if (px) document.documentElement.style.setProperty(name, px + "px");
  } catch (e) {
    // no storage: the usual widths
  }
});
