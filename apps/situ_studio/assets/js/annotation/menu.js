// The menu of the annotations: of the one under the mouse, of its track, of all.

import { ask, sure } from "../page/ask.js";
import { toast } from "../page/toast.js";
import { SHOWN } from "./rows.js";

// So many values of an attribute stand in the menu; the strip over the annotations has all of them.
const MOST = 12;

export function annotationItems(app, event) {
  const panel = app.annotation;
  if (!panel) return null;
  // a key asks for the chosen one, the mouse for what is under it
  const pointed = event.button === 2 || event.pointerType === "touch";
  const mouse = pointed && event.target.closest("#annotation-body") && !event.target.closest(".annotation-tools");
  if (mouse) panel.choose(event);
  const item = panel.item();
  const t = mouse ? panel.place(event).t : app.time.get().cursor;
  return [...(item ? ofItem(panel, item) : []), ...ofTrack(panel, t), ...ofAll(panel)];
}

function ofItem(panel, item) {
  const push = (what, more = {}) => panel.push(what, { id: item.id, ...more });
  const { sel, cursor } = panel.app.time.get();
  const at = (t) => panel.app.client.abs(t);
  const next = panel.told.items
    .filter((a) => a.track === item.track && a.from >= item.to && a.id !== item.id)
    .sort((a, b) => a.from - b.from)[0];
  const inside = item.from < cursor && cursor < item.to;
  return [
    ...values(panel, item),
    ...(item.proposed
      ? [
          { text: "Accept the proposal", run: () => push("accept") },
          { text: "Reject the proposal", run: () => push("remove") },
          "-",
        ]
      : []),
    {
      text: "Give it the selection",
      hint: "Shift+Enter",
      disabled: sel[0] == null || sel[1] == null,
      run: () => push("interval", { from: at(sel[0]), to: at(sel[1]) }),
    },
    { text: "Cut it at the cursor", hint: "x", disabled: !inside, run: () => push("split", { at: at(cursor) }) },
    { text: "Join it with the next", disabled: !next, run: () => push("merge", { with: next.id }) },
    { text: "To another track…", run: () => toTrack(panel, item) },
    { text: "Delete it", hint: "Delete", run: () => push("remove") },
    "-",
  ];
}

function values(panel, item) {
  const several = panel.told.attributes.length > 1;
  return panel.told.attributes
    .filter((a) => a.kind === "finite")
    .flatMap((a) => [
      ...a.values.slice(0, MOST).map(({ value, key }) => ({
        text: `${item.values[a.name] === value ? "✓ " : ""}${several ? `${a.name}: ` : ""}${value}`,
        hint: key,
        run: () => panel.push("value", { id: item.id, attribute: a.name, value }),
      })),
      "-",
    ]);
}

function ofTrack(panel, t) {
  const { track } = panel;
  const { sel } = panel.app.time.get();
  const both = sel[0] != null && sel[1] != null;
  const empty = !panel.told.items.some((a) => a.track === track);
  return [
    { text: "Annotate the selection", hint: "Enter", disabled: !both, run: () => panel.add(sel[0], sel[1]) },
    {
      text: "Annotate the selection on a new track",
      disabled: !both,
      run: () => {
        panel.track = panel.freeTrack();
        panel.add(sel[0], sel[1]);
      },
    },
    { text: "A point here", run: () => panel.add(t, t) },
    "-",
    { text: "Choose, make or rename a track…", run: () => panel.tools.chooseTrack() },
    {
      text: `Copy boundaries to track ${track}…`,
      disabled: !empty,
      run: () => panel.app.options.push?.("annotation_tracks", {}),
    },
    { text: `Delete all on track ${track}`, disabled: empty, run: () => deleteTrack(panel, track) },
    "-",
  ];
}

function ofAll(panel) {
  return [
    ...SHOWN.map(([shown, text]) => ({
      text: `${panel.shownTracks === shown ? "✓ " : ""}${text}`,
      run: () => panel.showTracks(shown),
    })),
    "-",
    { text: "Undo", hint: "Ctrl+Z", disabled: !panel.told.undo, run: () => panel.push("undo") },
    { text: "Redo", hint: "Ctrl+Shift+Z", disabled: !panel.told.redo, run: () => panel.push("redo") },
    { text: "Save", disabled: !panel.told.unsaved, run: () => panel.push("save") },
  ];
}

async function toTrack(panel, item) {
  const said = await ask({ title: "The track of this annotation", value: item.track, choices: panel.tracks() });
  const track = said?.text.trim().slice(0, 60);
  if (!track || track === item.track) return;
  panel.track = track;
  panel.push("to_track", { id: item.id, track });
}

async function deleteTrack(panel, track) {
  const n = panel.told.items.filter((a) => a.track === track).length;
  if (await sure(`Delete ${n} annotations of track ${track}? It can be undone.`, "Delete"))
    panel.push("delete_track", { track });
}

// The server has told which tracks there are, of all layers: [stream, track].
export async function copyBoundaries(panel, all) {
  const { stream } = panel.told;
  const others = all.filter(([s, t]) => s !== stream || t !== panel.track);
  const text = ([s, t]) => (s === stream ? t : `${s}: ${t}`);
  if (!others.length) return ask({ title: "There is no other track whose boundaries could be copied" });
  const said = await ask({
    title: `Copy the boundaries of which track to ${panel.track}? Values are the usual ones.`,
    value: text(others[0]),
    choices: others.map(text),
  });
  if (!said) return;
  const wanted = said.text.trim();
  const like = others.filter((o) => text(o).includes(wanted));
  const found = others.find((o) => text(o) === wanted) ?? (like.length === 1 ? like[0] : null);
  if (!found) return toast(`No track is called ${wanted}`);
  const [of, track] = found;
  panel.push("copy_boundaries", { of: track, track: panel.track, ...(of === stream ? {} : { stream: of }) });
}
