// The commands of the selected panel: it is moved, put next to another panel or in front of it, and closed.

import { showToast } from "./toast.js";

/** @returns {HTMLElement | null} the panel that is maximized, selected, has the focus or is under the mouse */
export function chosenPanel(app) {
  return (
    app.root.querySelector(".maxed[data-panel]") ??
    app.root.querySelector("[data-panel].selected") ??
    document.activeElement?.closest("[data-panel]") ??
    app.root.querySelector("[data-panel]:hover")
  );
}

const withPanel = (run) => (app) => {
  const panel = chosenPanel(app);
  if (panel) run(app, panel);
  else showToast("Select a panel or point at one");
};

const shiftPanel = (way) =>
  withPanel((app, panel) => app.options.push?.("shift_panel", { id: panel.dataset.panel, way }));

// Shows the next or previous panel of the tabs.
const stepTab = (by) =>
  withPanel((app, panel) => {
    const tabs = [...(panel.closest(".part-tabs")?.querySelectorAll("[role='tab']") ?? [])];
    const now = tabs.findIndex((tab) => tab.getAttribute("aria-selected") === "true");
    if (tabs.length)
      app.options.push?.("select_tab", { id: tabs[(now + by + tabs.length) % tabs.length].dataset.drag });
    else showToast("This panel is not in tabs");
  });

// Shows the values at both ends of the selection, their slope, and the statistics of the messages in between.
export function measureSelection(app, panel) {
  const [from, to] = app.time.get().sel;
  if (from == null || to == null) return showToast("Select a time first: drag with Shift, or press [ and ]");
  app.counting = setTimeout(() => showToast("Reading all messages of the selection …"), 600);
  const times = { from: app.client.toAbsolute(from), to: app.client.toAbsolute(to) };
  app.options.push?.("statistics", { panel: panel.dataset.panel, ...times });
}

export const panelCommands = {
  measure: withPanel(measureSelection),
  maximise: withPanel((app, panel) => app.options.push?.("maximise", { id: panel.dataset.panel })),
  panelLeft: shiftPanel("left"),
  panelRight: shiftPanel("right"),
  panelUp: shiftPanel("up"),
  panelDown: shiftPanel("down"),
  nextTab: stepTab(1),
  previousTab: stepTab(-1),
  closePanel: withPanel((app, panel) => app.options.push?.("remove_panel", { id: panel.dataset.panel })),
};

const nameOf = (panel) => panel.querySelector(".panel-body")?.getAttribute("aria-label") ?? "";
const PLACES = [
  ["left", "left of"],
  ["right", "right of"],
  ["above", "above"],
  ["below", "below"],
  ["tab", "as a tab with"],
];

// Lists the places of the chosen panel as entries of the palette.
export function placeEntries(app) {
  const panel = chosenPanel(app);
  if (!panel) return [];
  const id = panel.dataset.panel;
  return [...app.root.querySelectorAll("[data-panel]")]
    .filter((other) => other !== panel)
    .flatMap((other) =>
      PLACES.map(([side, words]) => ({
        text: `Put ${nameOf(panel)} ${words} ${nameOf(other)}`,
        hint: "",
        run: () => app.options.push?.("place_panel", { id, side, target: other.dataset.panel }),
      })),
    );
}
