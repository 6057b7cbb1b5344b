// One page of the studio: the time, the data socket, and all views. Independent of LiveView; `app.js` connects both.

import { createStore } from "./time/view.js";
import { InstantChannel } from "./data/channels.js";
import { DataClient } from "./data/client.js";
import { Playback } from "./time/playback.js";
import { timelineGestures } from "./time/gestures.js";
import { fetchAudio, listAudible } from "./time/audio.js";
import { findAction, timeAction } from "./page/keys.js";
import { Header } from "./page/header.js";
import { listenGoto } from "./page/dialogs.js";
import { Connection } from "./page/connection.js";
import { Address } from "./page/address.js";
import { Frames } from "./page/frames.js";
import { Gutter } from "./page/gutter.js";
import { openSession, rememberSession } from "./page/sessions.js";
import { Menu } from "./page/menu.js";
import { menuItems } from "./page/menus.js";
import { commands } from "./page/commands.js";
import { showToast } from "./page/toast.js";
import { onTheme } from "./page/theme.js";
import { readSetting } from "./page/settings.js";
import { formatAbsolute } from "./time/text.js";
import { onClock, setSelectionStart } from "./time/clock.js";

export class Studio {
  // options: {query, dataUrl, pcmUrl, stepUrl (functions), source, layout, edit, start, push, moved}; an exported page,
  // which has no server: {offline, connect, decode, fetchPcm, loadSpace, menuItems, allows}
  constructor(root, options) {
    this.root = root;
    this.options = options;
    /** @type {import("./page/compare.js").Compare | null} */
    this.compare = null;
    /** @type {import("./annotation/panel.js").AnnotationPanel | null} */
    this.annotation = null;
    /** @type {import("./page/palette.js").Palette | null} */
    this.palette = null;
    /** @type {import("./page/shared_cursors.js").SharedCursors | null} */
    this.together = null;
    /** @type {number | undefined} the timer of a message that statistics are being computed */
    this.counting = undefined;
    this.listening = new AbortController();
    this.time = createStore();
    if (!readSetting("follow")) this.time.dispatch({ type: "follow" });
    this.frames = new Frames(this.time);
    this.client = new DataClient({
      connect: options.connect ?? (() => new WebSocket(options.dataUrl())),
      decode: options.decode,
      time: this.time,
      onStatus: (s) => this.connection.setStatus(s),
      onReply: (r) => this.handleReply(r),
    });
    this.playback = new Playback({
      time: this.time,
      sounds: () => listAudible(this.frames.views),
      fetchPcm: options.fetchPcm ?? ((sound, a, b) => fetchAudio(options.pcmUrl(), this.client, sound, a, b)),
      onError: showToast,
    });
    this.address = new Address({
      time: this.time,
      client: this.client,
      fixed: options.offline === true,
      facts: () => ({ ...this.options, snap: this.client.snap, compare: this.compare }),
      moved: (href) => {
        options.moved?.(href);
        rememberSession(this);
      },
    });
    this.gutter = new Gutter(() => this.redrawAll());
    this.menu = new Menu(document.body, (target, e) => (options.menuItems ?? menuItems)(this, target, e));
    onClock(() => this.redrawAll());
    this.header = new Header(root, () => this.client.origin);
    this.connection = new Connection(this.header, showToast);
    this.time.subscribe((s, old) => this.handleTimeChange(s, old));
    onTheme(() => {
      for (const v of this.views) v.themeChanged?.();
    });
    this.addListeners();
    this.client.start();
  }

  // Redraws everything.
  redrawAll() {
    for (const v of this.views) {
      v.named = null;
      this.scheduleDraw(v);
    }
    for (const o of this.frames.overlays.values()) o.update(this.time.get());
  }

  get views() {
    return this.frames.views;
  }

  addView(view, { timeline = false, gestures = timeline } = {}) {
    this.frames.addView(view, { timeline });
    if (gestures) timelineGestures(view.el, this, view);
  }

  removeView(view) {
    this.frames.removeView(view);
  }

  scheduleDraw(view) {
    this.frames.scheduleDraw(view);
  }

  handleTimeChange(s, old) {
    if (setSelectionStart(s.sel[0])) this.redrawAll();
    this.frames.updateTimes(s, old);
    this.header.update(s);
    this.client.pump();
    this.address.save();
    if (s.mode !== old.mode) document.body.dataset.mode = s.mode;
  }

  handleReply(reply) {
    if (reply.first) this.openRecording(reply);
    if (this.growing !== reply.live) {
      if (this.growing && !reply.gone) this.handleSourceEnd(reply);
      else if (reply.live) this.handleSourceResume();
      this.growing = reply.live;
      this.header.setGrowing(reply.live);
      document.body.dataset.growing = reply.live ? "1" : "";
    }
    // another recording with the same name has other times, so the page reloads
    if (reply.replaced) return location.replace(location.pathname);
    this.connection.setStatus(reply.gone ? "gone" : "open");
    this.applySnap(reply);
    if (this.catalog !== undefined && this.catalog !== reply.version) this.options.push?.("streams_changed", {});
    this.catalog = reply.version;
  }

  // The live source has ended: the page stops following it and keeps the visible time range.
  handleSourceEnd(reply) {
    const at = formatAbsolute(Number(reply.to - this.client.origin), this.client.origin).slice(11, 19);
    this.connection.setEnded(`ended ${at}`);
    this.followed = this.time.get().mode === "live";
    this.time.dispatch({ type: "live", on: false });
    this.stopped = this.time.get();
    showToast(`The source ended at ${at}. Its data stay on the page.`);
  }

  // The source was restarted, here or on another node: the page follows it again unless the user has moved.
  handleSourceResume() {
    if (!this.connection.over) return;
    this.connection.setEnded("");
    showToast("The source has resumed.");
    const s = this.time.get();
    const untouched = s.view === this.stopped?.view && s.cursor === this.stopped?.cursor;
    if (this.followed && untouched) this.time.dispatch({ type: "live", on: true, width: s.liveWidth });
  }

  // Moves a snapped cursor to the message that the server found.
  applySnap({ asked, cursor }) {
    const s = this.time.get();
    if (!asked?.message.snap || s.mode !== "manual" || s.cursor !== asked.cursor || cursor === s.cursor) return;
    this.time.dispatch({ type: "cursor", t: cursor });
    for (const c of this.client.channels.values())
      if (c instanceof InstantChannel && c.at === asked.cursor) c.at = cursor;
  }

  openRecording(reply) {
    const origin = reply.from;
    this.time.dispatch({ type: "reset", from: 0, to: Number(reply.to - origin) });
    const asked = this.address.readLink(origin);
    if (asked.snap) this.client.setSnap(asked.snap);
    if (asked.view || asked.cursor != null || asked.sel) this.time.dispatch({ type: "restore", ...asked });
    // All images have begun then.
    else if (this.options.start)
      this.time.dispatch({ type: "cursor", t: Number(BigInt(this.options.start) - origin) });
    if (asked.live || (reply.live && !asked.view))
      this.time.dispatch({ type: "live", on: true, width: readSetting("live") });
    document.body.dataset.ready = "1";
    this.header.update(this.time.get());
  }

  // Runs an action of a toolbar button, a key or the palette.
  runAction(name) {
    if (!this.allows(name)) return;
    const s = this.time.get();
    if (name === "live" && s.mode !== "live" && !this.growing) {
      return showToast("This recording has ended: there is nothing to follow live");
    }
    if ((name === "back" || name === "on" || name === "jumpBack" || name === "jumpOn") && this.client.snap) {
      return this.stepMessage(name);
    }
    const action = timeAction(name, s);
    if (action) return this.time.dispatch(action);
    commands[name]?.(this);
  }

  // Returns whether the page has an action; an exported page has none that need a server.
  allows = (name) => this.options.allows?.(name) ?? true;

  // Steps to the previous or next message of the snapped stream, one step after the other.
  stepMessage(name) {
    this.stepping = (this.stepping ?? Promise.resolve()).then(() => this.stepOnce(name)).catch(() => {});
    return this.stepping;
  }

  async stepOnce(name) {
    const dir = name === "back" || name === "jumpBack" ? "previous" : "next";
    const to = await this.fetchMessageTime(dir, this.time.get().cursor);
    if (to != null) this.time.dispatch({ type: "nudge", by: to - this.time.get().cursor });
  }

  // Returns the time of the snapped stream's previous or next message, or null.
  async fetchMessageTime(dir, t) {
    const q = new URLSearchParams({ stream: this.client.snap, at: this.client.toAbsolute(t), dir });
    const r = await fetch(`${this.options.stepUrl()}&${q}`);
    const time = r.ok ? (await r.json()).time : null;
    return time == null ? null : this.client.toRelative(BigInt(time));
  }

  // Returns the time of the snapped stream's message nearest to a time if it is in view, else the time itself.
  async nearestMessageTime(t) {
    if (!this.client.snap) return t;
    const [from, to] = this.time.get().view;
    const found = await Promise.all([this.fetchMessageTime("previous", t + 1), this.fetchMessageTime("next", t)]);
    const seen = found.flatMap((m) => (m != null && m >= from && m <= to ? [m] : []));
    return seen.sort((a, b) => Math.abs(a - t) - Math.abs(b - t))[0] ?? t;
  }

  addListeners() {
    const { signal } = this.listening;
    const handleKeyDown = (e) => {
      if (e.target.closest?.("input, textarea, select, dialog") && !(e.ctrlKey && e.key === "k")) return;
      if (e.target.closest?.("button, a") && (e.key === " " || e.key === "Enter")) return;
      if (this.annotation?.handleKeyDown(e)) return e.preventDefault();
      const name = findAction(e);
      if (!name) return;
      e.preventDefault();
      this.runAction(name);
    };
    document.addEventListener("keydown", handleKeyDown, { signal });
    document.addEventListener("keyup", (e) => this.annotation?.handleKeyUp(e), { signal });
    this.root.addEventListener("click", (e) => {
      // opens the properties sidebar if it is hidden
      if (e.target.closest("[phx-click='select_panel'], #tree .name"))
        document.documentElement.dataset.right = "open";
      const session = e.target.closest("a.store[data-session]");
      if (session && !e.ctrlKey && !e.metaKey && !e.shiftKey) {
        e.preventDefault();
        openSession(this, session.getAttribute("href"));
      }
      const button = e.target.closest("[data-act]");
      if (!button) return;
      this.runAction(button.dataset.act);
      button.blur();
    });
    listenGoto(this.time, this.client);
    this.ticking = setInterval(() => this.showFrameRate(), 1000);
  }

  setLayout(layout, edit, annotate) {
    const { options } = this;
    if (layout === options.layout && edit === options.edit && annotate === options.annotate) return;
    if (edit !== options.edit || layout !== options.layout) this.edited = "layout";
    Object.assign(options, { layout, edit, annotate });
    // saved immediately, since a restarted server reads the layout from the address
    this.address.save(true);
  }

  plotPath(stream, path, kind) {
    this.options.push?.("plot_path", { stream, path, kind });
  }

  pushLaneCount(of, count) {
    this.options.push?.("lanes", { of, count: Math.min(count, 32) });
  }

  selectPanelOf(target) {
    const panel = target.closest?.("[data-panel]");
    if (panel) this.options.push?.("select_panel", { id: panel.dataset.panel });
  }

  snapTo(stream) {
    this.client.setSnap(stream || null);
    this.address.save(true);
  }

  showFrameRate() {
    const fps = this.frames.frameRate();
    this.header.setText(
      "tempo",
      fps >= 1 ? `${fps.toFixed(0)} fps   ${this.client.stats.roundTrip.toFixed(0)} ms` : "",
    );
  }

  destroy() {
    this.listening.abort();
    clearInterval(this.ticking);
    this.client.stop();
    this.menu.destroy();
    this.playback.end();
  }
}
