// Before the first paint: the theme chosen last, so that nothing flashes.
try {
  var chosen = localStorage.getItem("situ:theme");
  if (chosen === "light" || chosen === "dark") document.documentElement.dataset.theme = chosen;
} catch (e) {
  // no storage: the dark theme stays
}
