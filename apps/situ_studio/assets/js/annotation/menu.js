// Builds the context menu of annotations: entries for the annotation under the mouse, its track, and all of them.

import { askText, confirmAction } from "../page/questions.js";
import { showToast } from "../page/toast.js";
import { SHOWN } from "./rows.js";

// The menu lists at most this many values of an attribute; the toolbar above the annotations lists all.
const MOST = 12;

export function annotationItems(app, event) {
  const panel = app.annotation;
  if (!panel) return null;
  // the menu key refers to the selected annotation, the mouse to the annotation under it
  const pointed = event.button === 2 || event.pointerType === "touch";
  const mouse = pointed && event.target.closest("#annotation-body") && !event.target.closest(".annotation-tools");
  if (mouse) panel.selectUnder(event);
  const item = panel.findItem();
  const t = mouse ? panel.locatePointer(event).t : app.time.get().cursor;
  return [...(item ? itemEntries(panel, item) : []), ...trackEntries(panel, t), ...commonEntries(panel)];
}

function itemEntries(panel, item) {
  const pushEdit = (what, more = {}) => panel.pushEdit(what, { id: item.id, ...more });
  const { sel, cursor } = panel.app.time.get();
  const toAbsolute = (t) => panel.app.client.toAbsolute(t);
  const next = panel.state.items
    .filter((a) => a.track === item.track && a.from >= item.to && a.id !== item.id)
    .sort((a, b) => a.from - b.from)[0];
  const inside = item.from < cursor && cursor < item.to;
  return [
    ...valueItems(panel, item),
    ...(item.proposed
      ? [
          { text: "Accept the proposal", run: () => pushEdit("accept") },
          { text: "Reject the proposal", run: () => pushEdit("remove") },
          "-",
        ]
      : []),
    {
      text: "Set to the selection",
      hint: "Shift+Enter",
      disabled: sel[0] == null || sel[1] == null,
      run: () => pushEdit("interval", { from: toAbsolute(sel[0]), to: toAbsolute(sel[1]) }),
    },
    {
      text: "Split at the cursor",
      hint: "x",
      disabled: !inside,
      run: () => pushEdit("split", { at: toAbsolute(cursor) }),
    },
    { text: "Merge with the next", disabled: !next, run: () => pushEdit("merge", { with: next.id }) },
    { text: "Move to another track…", run: () => moveToTrack(panel, item) },
    { text: "Delete", hint: "Delete", run: () => pushEdit("remove") },
    { text: "Delete and close the gap", run: () => pushEdit("close_gap") },
    "-",
  ];
}

function valueItems(panel, item) {
  const several = panel.state.attributes.length > 1;
  return panel.state.attributes
    .filter((a) => a.kind === "finite")
    .flatMap((a) => [
      ...a.values.slice(0, MOST).map(({ value, key }) => ({
        text: `${item.values[a.name] === value ? "✓ " : ""}${several ? `${a.name}: ` : ""}${value}`,
        hint: key,
        run: () => panel.pushEdit("value", { id: item.id, attribute: a.name, value }),
      })),
      "-",
    ]);
}

function trackEntries(panel, t) {
  const { track } = panel;
  const { sel } = panel.app.time.get();
  const both = sel[0] != null && sel[1] != null;
  const empty = !panel.state.items.some((a) => a.track === track);
  return [
    {
      text: "Annotate the selection",
      hint: "Enter",
      disabled: !both,
      run: () => panel.addAnnotation(sel[0], sel[1]),
    },
    {
      text: "Annotate the selection on a new track",
      disabled: !both,
      run: () => {
        panel.track = panel.freeTrack();
        panel.addAnnotation(sel[0], sel[1]);
      },
    },
    { text: "A point here", run: () => panel.addAnnotation(t, t) },
    "-",
    {
      text: "Move all later annotations by the selection's length",
      disabled: !both,
      run: () =>
        panel.pushEdit("shift_after", { at: panel.app.client.toAbsolute(sel[0]), by: String(sel[1] - sel[0]) }),
    },
    { text: "Choose, create or rename a track…", run: () => panel.tools.chooseTrack() },
    {
      text: `Copy boundaries to track ${track}…`,
      disabled: !empty,
      run: () => panel.app.options.push?.("annotation_tracks", {}),
    },
    { text: `Delete all on track ${track}`, disabled: empty, run: () => deleteTrack(panel, track) },
    "-",
  ];
}

function commonEntries(panel) {
  return [
    ...SHOWN.map(([shown, text]) => ({
      text: `${panel.shownTracks === shown ? "✓ " : ""}${text}`,
      run: () => panel.showTracks(shown),
    })),
    "-",
    { text: "Undo", hint: "Ctrl+Z", disabled: !panel.state.undo, run: () => panel.pushEdit("undo") },
    { text: "Redo", hint: "Ctrl+Shift+Z", disabled: !panel.state.redo, run: () => panel.pushEdit("redo") },
    { text: "Save", disabled: !panel.state.unsaved, run: () => panel.pushEdit("save") },
  ];
}

async function moveToTrack(panel, item) {
  const said = await askText({
    title: "Move this annotation to track",
    value: item.track,
    choices: panel.trackNames(),
  });
  const track = said?.text.trim().slice(0, 60);
  if (!track || track === item.track) return;
  panel.track = track;
  panel.pushEdit("to_track", { id: item.id, track });
}

async function deleteTrack(panel, track) {
  const n = panel.state.items.filter((a) => a.track === track).length;
  if (await confirmAction(`Delete ${n} annotations of track ${track}? It can be undone.`, "Delete"))
    panel.pushEdit("delete_track", { track });
}

// Copies boundaries from another track. `all` lists the tracks of all layers as [stream, track].
export async function copyBoundaries(panel, all) {
  const { stream } = panel.state;
  const others = all.filter(([s, t]) => s !== stream || t !== panel.track);
  const trackLabel = ([s, t]) => (s === stream ? t : `${s}: ${t}`);
  if (!others.length) return askText({ title: "There is no other track to copy boundaries from" });
  const said = await askText({
    title: `Copy the boundaries of which track to ${panel.track}? Values are set to their defaults.`,
    value: trackLabel(others[0]),
    choices: others.map(trackLabel),
  });
  if (!said) return;
  const wanted = said.text.trim();
  const like = others.filter((o) => trackLabel(o).includes(wanted));
  const found = others.find((o) => trackLabel(o) === wanted) ?? (like.length === 1 ? like[0] : null);
  if (!found) return showToast(`There is no track named ${wanted}`);
  const [of, track] = found;
  panel.pushEdit("copy_boundaries", { of: track, track: panel.track, ...(of === stream ? {} : { stream: of }) });
}
