// The commands of the toolbar, keys and palette, except those of time (`keys.js` lists them). Each takes the studio.

import { readAnnotator } from "../annotation/annotator.js";
import { bookmarkCommands } from "./bookmarks.js";
import { panelCommands } from "./panel_commands.js";
import { askText } from "./questions.js";
import { stepSession } from "./sessions.js";
import { openGoto, openHelp, sessionTitle } from "./dialogs.js";
import { selectedPart } from "./selection.js";
import { setTheme } from "./theme.js";
import { formatIso } from "../time/text.js";
import { copyText, showToast } from "./toast.js";

export const commands = {
  ...bookmarkCommands,
  ...panelCommands,

  theme: () => setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light"),
  timing: (app) => app.header.nextTiming(),
  goto: openGoto,
  help: openHelp,
  settings: () => location.assign(document.querySelector("a[data-settings]")?.getAttribute("href") ?? "settings"),
  palette: (app) => app.palette?.open(),
  left: (app) => toggleSide(app, "left"),
  right: (app) => toggleSide(app, "right"),

  annotate: (app) => (app.annotation ? app.annotation.el.focus() : app.options.push?.("layer_dialog", {})),
  async derive(app, text = "") {
    const said = await askText({ title: "Expression of the derived stream, such as `Mic.Level` * 2", value: text });
    if (said?.text.trim()) app.options.push?.("derive", { text: said.text });
  },

  find: (app) => app.options.push?.("query_open", {}),

  // Adds a comment, which is stored as an annotation of the stream Markers.
  async marker(app) {
    if (app.client.origin === null) return;
    const { sel, cursor } = app.time.get();
    const both = sel[0] != null && sel[1] != null;
    const said = await askText({ title: both ? "Comment on the selection" : "Comment on this time" });
    const text = said?.text.trim();
    if (!text) return;
    const [from, to] = both ? sel : [cursor, cursor];
    app.options.push?.("annotation_marker", {
      from: app.client.toAbsolute(from),
      to: app.client.toAbsolute(to),
      text,
      by: readAnnotator(),
    });
  },

  nextSession: (app) => stepSession(app, 1),
  previousSession: (app) => stepSession(app, -1),

  review(app) {
    if (app.annotation) app.annotation.review.start();
    else showToast("Open annotations (a) to review their proposals");
  },

  compare: (app) => app.options.push?.("compare_dialog", {}),

  together: (app) => app.together?.toggleSharing(),

  undo: (app) => undoOrRedo(app, "undo"),
  redo: (app) => undoOrRedo(app, "redo"),
  beside: (app) => app.options.push?.("beside", {}),
  nextChange: (app) => stepToChange(app, 1),
  previousChange: (app) => stepToChange(app, -1),

  restore: (app) => app.root.querySelector(".stack.max") && app.options.push?.("restore", {}),

  search(app) {
    document.documentElement.dataset.left = "open";
    app.root.querySelector("#search")?.focus();
  },

  // Exports the selection (a missing end is that of the data), or the view if nothing is selected.
  export(app) {
    const { sel, view, data } = app.time.get();
    if (app.client.origin === null) return;
    if (!app.root.querySelector("[data-act='export']")) {
      return showToast("Nothing to export: exporting needs a recording on disk and a studio that is not read-only");
    }
    const selected = sel[0] != null || sel[1] != null;
    const [from, to] = selected
      ? [sel[0] ?? data[0], sel[1] ?? data[1]]
      : [Math.max(view[0], data[0]), Math.min(view[1], data[1])];
    const of = selected ? "selection" : "view";
    app.options.push?.("export_dialog", { from: app.client.toAbsolute(from), to: app.client.toAbsolute(to), of });
  },

  // Exports all panels as a page that opens without a server.
  savePage(app) {
    if (app.client.origin === null) return;
    const [from, to] = selectedPart(app);
    app.options.push?.("film_page", { from: app.client.toAbsolute(from), to: app.client.toAbsolute(to) });
  },

  // Copies the cursor's time in the format that "go to time" accepts.
  copyTime(app) {
    const { origin } = app.client;
    if (origin !== null) return copyText(formatIso(app.time.get().cursor, origin), "Time of the cursor copied");
  },

  copyNs(app) {
    if (app.client.origin !== null)
      return copyText(app.client.toAbsolute(app.time.get().cursor), "Nanoseconds of the cursor copied");
  },

  // Copies the time with its session, which "go to time" accepts in other sessions of the same list.
  copyPlace(app) {
    const { origin } = app.client;
    if (origin === null) return;
    return copyText(
      `${sessionTitle()}@${formatIso(app.time.get().cursor, origin)}`,
      "Session and time of the cursor copied",
    );
  },

  copyViewerLink: (app) => app.options.push?.("viewer_link", {}),

  copyLink(app) {
    app.address.save(true);
    return copyText(location.href, "Link copied", "The address bar holds the link");
  },
};

// Undoes or redoes the last change of the annotations or of the layout, whichever was changed last.
function undoOrRedo(app, way) {
  if (app.edited === "annotations" && app.annotation?.state[way]) app.annotation.pushEdit(way);
  else app.options.push?.(way, {});
}

const hoveredPanel = (app) => app.root.querySelector("[data-panel]:hover");

// Moves the cursor to the next start of a segment of the snapped stream. If it has no lanes, moves to the next start or
// end of a segment in the selected panel, or in all panels.
function stepToChange(app, way) {
  const { snap } = app.client;
  const starts = snap ? [...app.views].flatMap((v) => v.startTimes?.(snap) ?? []) : [];
  const all = starts.length ? starts : shownChanges(app);
  const { cursor } = app.time.get();
  const times = all.filter((t) => (way > 0 ? t > cursor + 0.5 : t < cursor - 0.5));
  if (!times.length)
    return showToast(way > 0 ? "No later change in the loaded data" : "No earlier change in the loaded data");
  const t = way > 0 ? Math.min(...times) : Math.max(...times);
  app.time.dispatch({ type: "nudge", by: t - cursor });
}

function shownChanges(app) {
  const chosen = app.root.querySelector("[data-panel].selected") ?? hoveredPanel(app);
  const own = [...app.views].filter((v) => v.changeTimes && (!chosen || chosen.contains(v.el)));
  const views = own.length ? own : [...app.views].filter((v) => v.changeTimes);
  return views.flatMap((v) => v.changeTimes());
}

// Toggles a sidebar; whether it is visible now also depends on the width of the window.
function toggleSide(app, side) {
  const shown = getComputedStyle(app.root.querySelector(`.${side}`)).display !== "none";
  document.documentElement.dataset[side] = shown ? "closed" : "open";
}
