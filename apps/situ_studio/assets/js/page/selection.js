// The part of the time that exports take.

// Returns the selection, or the view if nothing is selected, and which of the two it is.
export function selectedPart(app) {
  const { sel, view, data } = app.time.get();
  if (sel[0] != null && sel[1] != null) return [...sel, "selection"];
  return [Math.max(view[0], data[0]), Math.min(view[1], data[1]), "view"];
}
