// The annotation panel: one row for each track, on the same time axis as the other panels.

import { GUTTER } from "../page/theme.js";
import { showTip } from "../page/tip.js";
import { showToast } from "../page/toast.js";
import { ROW } from "./draw.js";
import { readAnnotator } from "./annotator.js";
import { KeyState } from "./keys.js";
import { dragEdge, edgeReach, describeAnnotation } from "./mouse.js";
import { freeNumber, rowLabel, listRows } from "./rows.js";
import { paintRows } from "./paint.js";
import { handleKey } from "./commands.js";
import { Merged } from "./merged.js";
import { Review } from "./review.js";
import { Segmentation } from "./segmentation.js";
import { Spatial } from "./spatial.js";
import { findTier, orderTracks, trackFor } from "./tiers.js";
import { Tools } from "./tools.js";
import { Transcription } from "./transcription.js";

const FIRST = "1";

export class AnnotationPanel {
  constructor(el, app) {
    this.el = el;
    this.app = app;
    el.classList.add("annotations");
    this.canvas = el.appendChild(document.createElement("canvas"));
    /** @type {import("./rows.js").AnnotationState} */
    this.state = { attributes: [], tracks: [], tiers: [], items: [], undo: 0, redo: 0 };
    /** @type {{id: string, edge: string, t: number} | null} the edge that the mouse moves */
    this.drag = null;
    this.keys = new KeyState();
    this.track = FIRST;
    this.attribute = 0;
    this.shownTracks = "all";
    this.review = new Review(this);
    this.merged = new Merged(this);
    this.segmentation = new Segmentation(this);
    this.transcription = new Transcription(this);
    this.spatial = new Spatial(this);
    this.tools = new Tools(el, this);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(el);
    el.addEventListener("pointerdown", (e) => this.handlePointerDown(e));
    el.addEventListener("pointermove", (e) => this.handlePointerMove(e));
    el.addEventListener("pointerleave", () => showTip(this, []));
    el.addEventListener("keydown", (e) => handleKey(this, e));
    this.resize();
  }

  pushEdit(what, more = {}) {
    this.app.edited = "annotations";
    const { version } = this.state;
    this.app.options.push?.("annotation_edit", { do: what, by: this.annotator, version, ...more });
  }

  // Applies the server's state of the annotations.
  applyUpdate(state) {
    this.raw = state;
    const toRelative = (ns) => this.app.client.toRelative(BigInt(ns));
    if (this.app.client.origin === null) return (this.early = state);
    const { tiers } = this.state;
    this.state = {
      ...state,
      items: state.items.map((a) => ({ ...a, from: toRelative(a.from), to: toRelative(a.to) })),
    };
    this.keys.setAttributes(state.attributes);
    if (state.shadowed && state.shadowed !== this.shadowed)
      showToast(`Another program saved different annotations; they are kept in ${state.shadowed}`);
    this.shadowed = state.shadowed;
    if (state.recovered && !this.welcomed) showToast(`${state.recovered} unsaved edits were restored`);
    this.welcomed = true;
    // the tier of the selected track was renamed or removed
    const gone = findTier(tiers, this.track) && !findTier(state.tiers, this.track);
    if (gone && !state.tracks.includes(this.track)) this.track = FIRST;
    if (!this.trackNames().includes(this.track)) this.track = this.trackNames()[0];
    if (this.selected && !this.findItem()) this.selected = null;
    if (this.attribute >= state.attributes.length) this.attribute = 0;
    this.app.gutter.reserveRoom(
      this,
      this.visibleRows().map((r) => this.rowName(r)),
    );
    this.tools.update();
    this.review.update();
    this.transcription.update();
    this.merged.update();
    this.fitHeight();
    this.scheduleAll();
  }

  // The height of the toolbar, which wraps to as many lines as it needs. The rows start below it.
  get toolsHeight() {
    return this.tools.height;
  }

  fitHeight() {
    const flex = `0 0 ${this.toolsHeight + this.visibleRows().length * ROW + 10}px`;
    const { parentElement: box } = this.el;
    if (box.style.flex === flex) return;
    box.style.flex = flex;
    // scrolls so that a new row is visible
    if (this.welcomed) box.scrollIntoView({ block: "nearest" });
  }

  // Redraws this panel and the images, which also show boxes and points.
  scheduleAll() {
    this.app.scheduleDraw(this);
    for (const v of this.app.views) if (v.baseLayer) this.app.scheduleDraw(v);
  }

  get annotator() {
    return readAnnotator();
  }

  trackNames() {
    const { tiers, tracks } = this.state;
    // a schema with tiers says which tracks there are
    return orderTracks(tiers.length && this.track === FIRST ? tracks : [...tracks, this.track], tiers);
  }

  visibleRows() {
    const { state, track, attribute, shownTracks: shown } = this;
    const spatial = this.spatial.kind != null;
    const rows = { state, track, attribute, shown, spatial, tracks: this.trackNames() };
    return this.merged.extendRows(listRows(rows, this.app.time.get().view));
  }

  rowName(row) {
    if (row.layer) return row.layer;
    const several = this.spatial.kind == null && this.state.attributes.length > 1;
    const tier = findTier(this.state.tiers, row.track);
    if (tier) return `${tier.depth ? "└ " : ""}${row.track}`;
    return rowLabel(row, this.state.attributes, several);
  }

  showTracks(shown) {
    this.shownTracks = shown;
    this.fitHeight();
    this.app.scheduleDraw(this);
  }

  // Returns the lowest number that is not yet the name of a track.
  freeTrack() {
    return freeNumber(this.trackNames());
  }

  findItem(id = this.selected) {
    return this.state.items.find((a) => a.id === id) ?? null;
  }

  // --- keys: called for every key of the page while annotating; returns true if the key was handled

  handleKeyDown(e) {
    if (this.review.handleKeyDown(e) || this.segmentation.handleKeyDown(e)) return true;
    if (e.ctrlKey || e.metaKey || e.altKey) return false;
    if (this.keys.has(e.key)) {
      if (!e.repeat) this.addFinished(this.keys.pressKey(e.key, this.app.time.get().cursor, performance.now()));
      this.app.scheduleDraw(this);
      return true;
    }
    if (e.key === "Escape" && this.keys.cancelOpen()) return (this.app.scheduleDraw(this), true);
    return false;
  }

  handleKeyUp(e) {
    if (this.keys.has(e.key) && !this.review.active)
      this.addFinished(this.keys.releaseKey(e.key, this.app.time.get().cursor, performance.now()));
  }

  addFinished(annotation) {
    if (annotation) this.addAnnotation(annotation.from, annotation.to, annotation.values);
  }

  // Without a track, the annotation is on the chosen one, or on the tier that has the attribute of its value.
  addAnnotation(from, to, values = {}, track = trackFor(this.state.tiers, this.track, Object.keys(values)[0])) {
    const { client } = this.app;
    const [a, b] = [from, to].map((t) => client.toAbsolute(t));
    this.pushEdit("add", { from: a, to: b, track, values, by: this.annotator });
  }

  moveEdge({ id }, edge, t, alone = false) {
    this.pushEdit("edge", { id, edge, to: this.app.client.toAbsolute(t), alone });
  }

  rippleEdge({ id }, edge, t) {
    this.pushEdit("ripple", { id, edge, to: this.app.client.toAbsolute(t) });
  }

  // --- the mouse

  locatePointer(e) {
    const box = this.el.getBoundingClientRect();
    const { view } = this.app.time.get();
    const px = (view[1] - view[0]) / (box.width - GUTTER.left - GUTTER.right);
    const t = view[0] + (e.clientX - box.left - GUTTER.left) * px;
    const row = this.visibleRows()[Math.floor((e.clientY - box.top - this.toolsHeight) / ROW)];
    return { t, px, track: row?.track ?? null, attribute: row?.attribute ?? null, other: row?.layer != null };
  }

  // Returns the annotation under the mouse and, if the pointer is close to one, its edge: {item, edge}.
  annotationUnder(e) {
    const { t, px, track, other } = this.locatePointer(e);
    const own = other ? [] : this.state.items.filter((a) => a.track === track);
    for (const edge of ["to", "from"]) {
      const item = own.find((a) => Math.abs(a[edge] - t) < edgeReach(e) * px);
      if (item) return { item, edge };
    }
    return { item: own.find((a) => a.from <= t && t <= a.to) ?? null, edge: null };
  }

  handlePointerDown(e) {
    if (e.button !== 0 || e.target.closest(".annotation-tools")) return;
    this.el.focus({ preventScroll: true });
    const { item, edge } = this.selectUnder(e);
    if (edge) dragEdge(this, e, item, edge);
  }

  // Selects the track, attribute and annotation under the mouse.
  selectUnder(e) {
    const { track, attribute } = this.locatePointer(e);
    const found = this.annotationUnder(e);
    if (track !== null) this.track = track;
    if (attribute !== null) this.attribute = attribute;
    this.selected = found.item?.id ?? null;
    this.tools.update();
    this.app.scheduleDraw(this);
    return found;
  }

  handlePointerMove(e) {
    if (e.buttons) return showTip(this, []);
    const { item, edge } = this.annotationUnder(e);
    this.el.style.cursor = edge ? "ew-resize" : "";
    showTip(this, item ? describeAnnotation(item, this.app.client.origin) : [], e.clientX, e.clientY);
  }

  segmentUnder(e) {
    const { item, edge } = this.annotationUnder(e);
    return item && !edge && item.to > item.from ? [item.from, item.to] : null;
  }

  changeTimes() {
    return this.state.items.flatMap((a) => [a.from, a.to]);
  }

  // --- drawing

  resize() {
    const w = this.el.clientWidth,
      h = this.el.clientHeight;
    if (!w || !h) return;
    this.fitHeight();
    this.canvas.width = Math.round(w * devicePixelRatio);
    this.canvas.height = Math.round(h * devicePixelRatio);
    this.app.scheduleDraw(this);
  }

  render() {
    if (this.early && this.app.client.origin !== null) {
      const { early } = this;
      this.early = null;
      this.applyUpdate(early);
    }
    paintRows(this);
    this.drawn = (this.drawn ?? 0) + 1;
  }

  cursorMoved() {
    if (this.keys.open.size || this.segmentation.active) this.app.scheduleDraw(this);
  }

  themeChanged() {
    this.render();
  }

  destroy() {
    this.review.stop();
    this.transcription.stop();
    this.observer.disconnect();
    this.state = { ...this.state, attributes: [] };
    this.scheduleAll();
    this.app.gutter.reserveRoom(this, null);
    showTip(this, []);
  }
}
