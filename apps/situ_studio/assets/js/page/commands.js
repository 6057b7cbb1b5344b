// The commands of toolbar, keys and palette except those of time (`keys.js` names them): each a function of the page.

import { annotator } from "../annotation/annotator.js";
import { ask } from "./ask.js";
import { openGoto, openHelp, title } from "./dialogs.js";
import { setTheme } from "./theme.js";
import { iso } from "../time/text.js";
import { copy, toast } from "./toast.js";

export const commands = {
  theme: () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light"),
  timing: (app) => app.header.nextTiming(),
  goto: openGoto,
  help: openHelp,
  settings: () => location.assign(document.querySelector("[data-settings]")?.href ?? "settings"),
  palette: (app) => app.palette?.open(),
  left: (app) => toggleSide(app, "left"),
  right: (app) => toggleSide(app, "right"),

  annotate: (app) => (app.annotation ? app.annotation.el.focus() : app.options.push?.("annotation_dialog", {})),
  async derive(app, text = "") {
    const said = await ask({ title: "The expression of a derived stream, such as `Mic.Level` * 2", value: text });
    if (said?.text.trim()) app.options.push?.("derive", { text: said.text });
  },

  find: (app) => app.options.push?.("query_open", {}),

  // A comment stays with the recording, as an annotation of the stream Markers.
  async marker(app) {
    if (app.client.origin === null) return;
    const { sel, cursor } = app.time.get();
    const both = sel[0] != null && sel[1] != null;
    const said = await ask({ title: both ? "Comment on the selection" : "Comment on this time" });
    const text = said?.text.trim();
    if (!text) return;
    const [from, to] = both ? sel : [cursor, cursor];
    app.options.push?.("annotation_marker", {
      from: app.client.abs(from),
      to: app.client.abs(to),
      text,
      by: annotator(),
    });
  },

  compare: (app) => app.options.push?.("compare_dialog", {}),

  together: (app) => app.together?.toggle(),

  undo: (app) => takeBack(app, "undo"),
  redo: (app) => takeBack(app, "redo"),
  beside: (app) => app.options.push?.("beside", {}),
  nextChange: (app) => stepChange(app, 1),
  previousChange: (app) => stepChange(app, -1),

  maximise(app) {
    const panel =
      app.root.querySelector(".maxed[data-panel]") ?? app.root.querySelector("[data-panel].selected") ?? hovered(app);
    if (panel) app.options.push?.("maximise", { id: panel.dataset.panel });
    else toast("Point at a panel, or select one, to let it fill the window");
  },

  restore: (app) => app.root.querySelector(".stack.max") && app.options.push?.("restore", {}),

  search(app) {
    document.documentElement.dataset.left = "open";
    app.root.querySelector("#search")?.focus();
  },

  // The selection; where one end is missing that of the data, and without any the view.
  export(app) {
    const { sel, view, data } = app.time.get();
    if (app.client.origin === null) return;
    if (!app.root.querySelector("[data-act='export']")) {
      return toast("No part of this can be saved: that needs a recording on disk and a studio that is not read only");
    }
    const selected = sel[0] != null || sel[1] != null;
    const [from, to] = selected
      ? [sel[0] ?? data[0], sel[1] ?? data[1]]
      : [Math.max(view[0], data[0]), Math.min(view[1], data[1])];
    const of = selected ? "selection" : "view";
    app.options.push?.("export_dialog", { from: app.client.abs(from), to: app.client.abs(to), of });
  },

  // As "go to time" takes it.
  copyTime(app) {
    const { origin } = app.client;
    if (origin !== null) return copy(iso(app.time.get().cursor, origin), "Time of the cursor copied");
  },

  copyNs(app) {
    if (app.client.origin !== null)
      return copy(app.client.abs(app.time.get().cursor), "Nanoseconds of the cursor copied");
  },

  // The same with the session, which "go to time" takes in another session of the same list.
  copyPlace(app) {
    const { origin } = app.client;
    if (origin === null) return;
    return copy(`${title()}@${iso(app.time.get().cursor, origin)}`, "Session and time of the cursor copied");
  },

  copyViewerLink: (app) => app.options.push?.("viewer_link", {}),

  copyLink(app) {
    app.address.save(true);
    return copy(location.href, "Link copied", "The address bar holds the link");
  },
};

// Of the annotations or of the layout, whichever was changed last.
function takeBack(app, way) {
  if (app.edited === "annotations" && app.annotation?.told[way]) app.annotation.push(way);
  else app.options.push?.(way, {});
}

const hovered = (app) => app.root.querySelector("[data-panel]:hover");

// The nearest beginning or end of a segment in the selected panel's lanes, or in all.
function stepChange(app, way) {
  const chosen = app.root.querySelector("[data-panel].selected") ?? hovered(app);
  const own = [...app.views].filter((v) => v.changes && (!chosen || chosen.contains(v.el)));
  const views = own.length ? own : [...app.views].filter((v) => v.changes);
  const { cursor } = app.time.get();
  const times = views.flatMap((v) => v.changes()).filter((t) => (way > 0 ? t > cursor + 0.5 : t < cursor - 0.5));
  if (!times.length)
    return toast(way > 0 ? "No later change in what is loaded" : "No earlier change in what is loaded");
  const t = way > 0 ? Math.min(...times) : Math.max(...times);
  app.time.dispatch({ type: "nudge", by: t - cursor });
}

// Shown or hidden: what it is now depends on the width of the window, too.
function toggleSide(app, side) {
  const shown = getComputedStyle(app.root.querySelector(`.${side}`)).display !== "none";
  document.documentElement.dataset[side] = shown ? "closed" : "open";
}
