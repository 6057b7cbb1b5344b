// Reviews proposals one after the other: the current one is selected and played in a loop until it is accepted,
// rejected or corrected with a key.

import { showToast } from "../page/toast.js";

/** @typedef {import("./rows.js").Annotation & {proposed?: boolean}} Proposal */

// A proposal that is a point in time is played with this much around it, in ns.
const AROUND = 5e8;
// The least length of the view around a proposal, in ns.
const CONTEXT = 4e9;

// Returns the proposals in the order of their times.
/** @param {Proposal[]} items @returns {Proposal[]} */
export function listProposals(items) {
  return items
    .filter((a) => a.proposed)
    .sort((a, b) => a.from - b.from || a.to - b.to || a.track.localeCompare(b.track));
}

// Returns the proposal after (by = 1) or before (by = -1) an annotation, or the first or last one if there is none.
/** @param {Proposal[]} items @param {Proposal | null} now @param {number} by */
export function neighborProposal(items, now, by) {
  const all = listProposals(items);
  const others = all.filter((a) => a.id !== now?.id);
  if (!now || !others.length) return others[0] ?? null;
  const order = listProposals([...others, { ...now, proposed: true }]);
  const at = order.findIndex((a) => a.id === now.id);
  return order[(at + by + order.length) % order.length];
}

// Returns the text of the progress, or "" if there was never a proposal.
/** @param {{total: number, reviewed: number, accepted: number, corrected: number} | undefined} review */
export function progressText(review) {
  if (!review?.total) return "";
  const corrected = review.corrected ? `, ${review.corrected} of them corrected` : "";
  return `${review.reviewed} of ${review.total} reviewed, ${review.accepted} accepted${corrected}`;
}

export const REVIEW_KEYS =
  "Enter accepts, Delete rejects, a value's key corrects, [ and ] move an edge, n and N go on and back, Escape ends";

// Returns the view that shows a proposal: the present one if the proposal is well visible in it.
export function viewAround({ from, to }, view) {
  const width = view[1] - view[0];
  const length = to - from;
  if (from >= view[0] && to <= view[1] && length >= width / 20) return view;
  const half = Math.max(length * 2, CONTEXT) / 2;
  const middle = (from + to) / 2;
  return [middle - half, middle + half];
}

export class Review {
  constructor(panel) {
    this.panel = panel;
    this.active = false;
    // the proposals whose edits the server has not confirmed yet
    this.settled = new Set();
  }

  get time() {
    return this.panel.app.time;
  }

  start() {
    const { items } = this.panel.state;
    const { cursor } = this.time.get();
    const all = listProposals(items);
    if (!all.length) return showToast("There are no proposals to review");
    this.active = true;
    this.settled.clear();
    this.repeated = this.time.get().repeat;
    this.show(all.find((a) => a.to >= cursor) ?? all[0]);
  }

  stop() {
    if (!this.active) return;
    this.active = false;
    this.time.dispatch({ type: "stop" });
    if (this.time.get().repeat !== this.repeated) this.time.dispatch({ type: "repeat" });
    this.panel.tools.update();
  }

  // Selects a proposal and plays it in a loop.
  show(item) {
    const { panel, time } = this;
    panel.selected = item.id;
    panel.track = item.track;
    const [from, to] = viewAround(item, time.get().view);
    time.dispatch({ type: "view", from, to });
    time.dispatch({ type: "select", from: item.from, to: item.to });
    this.play(item);
    panel.tools.update();
    panel.app.scheduleDraw(panel);
  }

  play({ from, to }) {
    const around = to > from ? 0 : AROUND;
    this.time.dispatch({ type: "play", from: from - around, to: to + around, repeat: true });
  }

  openItems() {
    return this.panel.state.items.filter((a) => !this.settled.has(a.id));
  }

  step(by) {
    const next = neighborProposal(this.openItems(), this.panel.findItem(), by);
    if (next) this.show(next);
  }

  // Accepts, rejects or corrects the current proposal, and shows the next one.
  settle(what, more = {}) {
    const { panel } = this;
    const item = panel.findItem();
    if (!item?.proposed || this.settled.has(item.id)) return this.step(1);
    this.settled.add(item.id);
    const next = neighborProposal(this.openItems(), item, 1);
    panel.pushEdit(what, { id: item.id, by: panel.annotator, ...more });
    if (next) return this.show(next);
    this.stop();
    this.finished = true;
  }

  // Called when the server has sent the annotations after an edit.
  update() {
    const open = new Set(listProposals(this.panel.state.items).map((a) => a.id));
    for (const id of this.settled) if (!open.has(id)) this.settled.delete(id);
    if (!this.finished || open.size) return;
    this.finished = false;
    showToast(`All proposals are reviewed: ${progressText(this.panel.state.review)}`);
  }

  // Handles a key of the page; returns true if the review has handled it.
  handleKeyDown(e) {
    if (!this.active || e.ctrlKey || e.metaKey || e.altKey) return false;
    const { panel } = this;
    const chosen = panel.keys.keys.get(e.key);
    const item = panel.findItem();
    const cursor = this.time.get().cursor;
    if (chosen) this.settle("correct", { values: { [chosen.attribute]: chosen.value } });
    else if (e.key === "Enter") this.settle("accept");
    else if (e.key === "Delete" || e.key === "Backspace") this.settle("remove");
    else if (e.key === "n" || e.key === "ArrowDown") this.step(1);
    else if (e.key === "N" || e.key === "ArrowUp") this.step(-1);
    else if ((e.key === "[" || e.key === "]") && item) panel.moveEdge(item, e.key === "[" ? "from" : "to", cursor);
    else if (e.key === " " && item) {
      if (this.time.get().mode === "play") this.time.dispatch({ type: "stop" });
      else this.play(item);
    } else if (e.key === "Escape") this.stop();
    else return false;
    return true;
  }
}
