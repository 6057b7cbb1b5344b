// Handles the keys of the annotation panel while it has the focus. Keys of values work everywhere (`keys.js`).

export function handleKey(panel, e) {
  // the keys of a review are handled by the page (`review.js`)
  if (e.target.closest("input, select") || (panel.review.active && !e.ctrlKey && !e.metaKey)) return;
  const undo = (e.ctrlKey || e.metaKey) && e.key.toLowerCase() === "z";
  if (undo) panel.pushEdit(e.shiftKey ? "redo" : "undo");
  else if (e.ctrlKey || e.metaKey || e.altKey || !runCommand(panel, e)) return;
  e.preventDefault();
  e.stopPropagation();
  panel.app.scheduleDraw(panel);
}

// Runs the command of a key; returns false if the key has none.
function runCommand(panel, { key, shiftKey }) {
  const { sel, cursor } = panel.app.time.get();
  const chosen = panel.findItem();
  const both = sel[0] != null && sel[1] != null;
  const toAbsolute = (t) => panel.app.client.toAbsolute(t);
  if (key === "Enter" && shiftKey && both && chosen)
    panel.pushEdit("interval", { id: chosen.id, from: toAbsolute(sel[0]), to: toAbsolute(sel[1]) });
  else if (key === "Enter" && both) panel.addAnnotation(sel[0], sel[1]);
  else if ((key === "d" || key === "D") && panel.merged.active) panel.merged.step(key === "d" ? 1 : -1);
  else if (key === "g") panel.segmentation.switchMode();
  else if (key === "T") panel.transcription.start();
  else if ((key === "<" || key === ">") && chosen) shiftBy(panel, chosen, key === "<" ? -1 : 1);
  else if (key === "i") panel.addAnnotation(cursor, cursor);
  else if ((key === "[" || key === "]") && chosen) panel.moveEdge(chosen, key === "[" ? "from" : "to", cursor);
  else if (shiftKey && (key === "ArrowLeft" || key === "ArrowRight"))
    selectNeighbor(panel, key === "ArrowLeft" ? -1 : 1);
  else if ((key === "Delete" || key === "Backspace") && chosen) panel.pushEdit("remove", { id: chosen.id });
  else if (key === "x" && chosen) panel.pushEdit("split", { id: chosen.id, at: toAbsolute(cursor) });
  else if (key === "Tab" && panel.state.attributes.length > 1) nextAttribute(panel, shiftKey ? -1 : 1);
  else if (key === "ArrowDown" || key === "ArrowUp") nextTrack(panel, key === "ArrowDown" ? 1 : -1);
  else return false;
  return true;
}

// Moves an annotation and its children by a half percent of the view.
function shiftBy(panel, chosen, direction) {
  const { view } = panel.app.time.get();
  const by = Math.round((direction * (view[1] - view[0])) / 200);
  panel.pushEdit("shift", { id: chosen.id, by: String(by) });
}

// Selects the annotation before or after the cursor on the current track, and scrolls to it.
function selectNeighbor(panel, by) {
  const { time } = panel.app;
  const { cursor } = time.get();
  const own = panel.state.items.filter((a) => a.track === panel.track).sort((a, b) => a.from - b.from);
  const next = by > 0 ? own.find((a) => a.from > cursor) : own.filter((a) => a.from < cursor).pop();
  if (!next) return;
  panel.selected = next.id;
  time.dispatch({ type: "select", from: next.from, to: next.to });
  time.dispatch({ type: "nudge", by: next.from - cursor });
  panel.tools.update();
}

function nextAttribute(panel, by) {
  const n = panel.state.attributes.length;
  panel.attribute = (panel.attribute + by + n) % n;
  panel.tools.update();
}

function nextTrack(panel, by) {
  const all = panel.trackNames();
  panel.track = all[Math.min(Math.max(all.indexOf(panel.track) + by, 0), all.length - 1)];
}
