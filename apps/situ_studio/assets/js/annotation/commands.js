// The keys of the annotation panel when it has the focus; those of values work everywhere (`keys.js`).

export function typed(panel, e) {
  if (e.target.closest("input, select")) return;
  const undo = (e.ctrlKey || e.metaKey) && e.key.toLowerCase() === "z";
  if (undo) panel.push(e.shiftKey ? "redo" : "undo");
  else if (e.ctrlKey || e.metaKey || e.altKey || !command(panel, e)) return;
  e.preventDefault();
  e.stopPropagation();
  panel.app.schedule(panel);
}

// Whether the key was one of ours.
function command(panel, { key, shiftKey }) {
  const { sel, cursor } = panel.app.time.get();
  const chosen = panel.item();
  const both = sel[0] != null && sel[1] != null;
  const at = (t) => panel.app.client.abs(t);
  if (key === "Enter" && shiftKey && both && chosen)
    panel.push("interval", { id: chosen.id, from: at(sel[0]), to: at(sel[1]) });
  else if (key === "Enter" && both) panel.add(sel[0], sel[1]);
  else if (key === "i") panel.add(cursor, cursor);
  else if ((key === "[" || key === "]") && chosen) panel.moveEdge(chosen, key === "[" ? "from" : "to", cursor);
  else if (shiftKey && (key === "ArrowLeft" || key === "ArrowRight")) choose(panel, key === "ArrowLeft" ? -1 : 1);
  else if ((key === "Delete" || key === "Backspace") && chosen) panel.push("remove", { id: chosen.id });
  else if (key === "x" && chosen) panel.push("split", { id: chosen.id, at: at(cursor) });
  else if (key === "Tab" && panel.told.attributes.length > 1) nextAttribute(panel, shiftKey ? -1 : 1);
  else if (key === "ArrowDown" || key === "ArrowUp") nextTrack(panel, key === "ArrowDown" ? 1 : -1);
  else return false;
  return true;
}

// The annotation before or after the cursor on the track: chosen, selected, and in sight.
function choose(panel, by) {
  const { time } = panel.app;
  const { cursor } = time.get();
  const own = panel.told.items.filter((a) => a.track === panel.track).sort((a, b) => a.from - b.from);
  const next = by > 0 ? own.find((a) => a.from > cursor) : own.filter((a) => a.from < cursor).pop();
  if (!next) return;
  panel.selected = next.id;
  time.dispatch({ type: "select", from: next.from, to: next.to });
  time.dispatch({ type: "nudge", by: next.from - cursor });
  panel.tools.update();
}

function nextAttribute(panel, by) {
  const n = panel.told.attributes.length;
  panel.attribute = (panel.attribute + by + n) % n;
  panel.tools.update();
}

function nextTrack(panel, by) {
  const all = panel.tracks();
  panel.track = all[Math.min(Math.max(all.indexOf(panel.track) + by, 0), all.length - 1)];
}
