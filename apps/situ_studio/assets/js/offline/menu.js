// The context menus of an exported page.

import { timeAt, timeItems } from "../page/menus.js";
import { canDrawVector, saveImage, saveVector } from "../page/image_file.js";
import { copyText } from "../page/toast.js";

export function menuItems(app, target, event) {
  const panel = target.closest("[data-panel]");
  const body = panel?.querySelector(".panel-body") ?? target.closest("#navigator");
  if (!body) return null;
  const times = panel?.matches(".timeline") || !panel ? timeItems(app, timeAt(app, body, event)) : [];
  if (!panel) return times;
  const { vis } = JSON.parse(body.dataset.config);
  const pushEvent = (name, more = {}) => app.options.push(name, { id: panel.dataset.panel, ...more });
  return [
    ...times,
    ...(times.length ? ["-"] : []),
    { text: panel.matches(".maxed") ? "Restore" : "Maximize", hint: "m", run: () => pushEvent("maximise") },
    { text: "Save as PNG", run: () => saveImage(app, body) },
    ...(canDrawVector(app, body) ? [{ text: "Save as SVG", run: () => saveVector(app, body) }] : []),
    { text: "Copy the names", run: () => copyText(vis.map((v) => v.name).join("\n"), "Copied") },
  ];
}
