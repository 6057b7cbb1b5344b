// One page: the time, the data socket, and everything that draws. Knows nothing of LiveView; `app.js` connects both.

import { createStore } from "./time/view.js";
import { DataClient } from "./data/client.js";
import { Playback } from "./time/playback.js";
import { timelineGestures } from "./time/gestures.js";
import { fetchSound, sounds } from "./time/sound.js";
import { actionFor, timeAction } from "./page/keys.js";
import { Header } from "./page/header.js";
import { listenGoto } from "./page/dialogs.js";
import { Connection } from "./page/connection.js";
import { Address } from "./page/address.js";
import { Frames } from "./page/frames.js";
import { Gutter } from "./page/gutter.js";
import { Menu } from "./page/menu.js";
import { menuItems } from "./page/menus.js";
import { commands } from "./page/commands.js";
import { toast } from "./page/toast.js";
import { onTheme } from "./page/theme.js";
import { setting } from "./page/settings.js";
import { absolute } from "./time/text.js";
import { onClock, setSelected } from "./time/clock.js";

export class Studio {
  // options: {query, dataUrl, pcmUrl, stepUrl (functions), source, layout, edit, push, moved}
  constructor(root, options) {
    Object.assign(this, { root, options });
    this.time = createStore();
    if (!setting("follow")) this.time.dispatch({ type: "follow" });
    this.frames = new Frames(this.time);
    this.client = new DataClient({
      connect: () => new WebSocket(options.dataUrl()),
      time: this.time,
      onStatus: (s) => this.connection.set(s),
      onReply: (r) => this.replied(r),
    });
    this.playback = new Playback({
      time: this.time,
      sounds: () => sounds(this.frames.views),
      fetchPcm: (sound, a, b) => fetchSound(options.pcmUrl(), this.client, sound, a, b),
      onError: toast,
    });
    this.address = new Address({
      time: this.time,
      client: this.client,
      facts: () => ({ ...this.options, snap: this.client.snap, compare: this.compare }),
      moved: options.moved,
    });
    this.gutter = new Gutter(() => this.redraw());
    this.menu = new Menu(document.body, (target, e) => menuItems(this, target, e));
    onClock(() => this.redraw());
    this.header = new Header(root, () => this.client.origin);
    this.connection = new Connection(this.header, toast);
    this.time.subscribe((s, old) => this.changed(s, old));
    onTheme(() => {
      for (const v of this.views) v.themeChanged?.();
    });
    this.listen();
    this.client.start();
  }

  // Everything, as after a change of the window.
  redraw() {
    for (const v of this.views) {
      v.named = null;
      this.schedule(v);
    }
    for (const o of this.frames.overlays.values()) o.update(this.time.get());
  }

  get views() {
    return this.frames.views;
  }

  add(view, { timeline = false, gestures = timeline } = {}) {
    this.frames.add(view, { timeline });
    if (gestures) timelineGestures(view.el, this, view);
  }

  remove(view) {
    this.frames.remove(view);
  }

  schedule(view) {
    this.frames.schedule(view);
  }

  changed(s, old) {
    if (setSelected(s.sel[0])) this.redraw();
    this.frames.moved(s, old);
    this.header.update(s);
    this.client.pump();
    this.address.save();
    if (s.mode !== old.mode) document.body.dataset.mode = s.mode;
  }

  replied(reply) {
    if (reply.first) this.opened(reply);
    if (this.growing !== reply.live) {
      if (this.growing && !reply.gone) this.ended(reply);
      else if (reply.live) this.goesOn();
      this.growing = reply.live;
      this.header.grows(reply.live);
      document.body.dataset.growing = reply.live ? "1" : "";
    }
    // another recording under the name has other times: the page begins with it
    if (reply.replaced) return location.replace(location.pathname);
    this.connection.set(reply.gone ? "gone" : "open");
    this.snapped(reply);
    if (this.catalog !== undefined && this.catalog !== reply.version) this.options.push?.("streams_changed", {});
    this.catalog = reply.version;
  }

  // A live source has ended: the page stops following and keeps the time range it showed.
  ended(reply) {
    const at = absolute(Number(reply.to - this.client.origin), this.client.origin).slice(11, 19);
    this.connection.ended(`ended ${at}`);
    this.followed = this.time.get().mode === "live";
    this.time.dispatch({ type: "live", on: false });
    this.stopped = this.time.get();
    toast(`The source ended at ${at}. The page keeps its data.`);
  }

  // It was started again, here or on another node: the page follows it again, unless somebody looks at what it has.
  goesOn() {
    if (!this.connection.over) return;
    this.connection.ended("");
    toast("The source goes on.");
    const s = this.time.get();
    const untouched = s.view === this.stopped.view && s.cursor === this.stopped.cursor;
    if (this.followed && untouched) this.time.dispatch({ type: "live", on: true, width: s.liveWidth });
  }

  // A snapped cursor moves to where the server found the message.
  snapped({ asked, cursor }) {
    const s = this.time.get();
    if (!asked?.message.snap || s.mode !== "manual" || s.cursor !== asked.cursor || cursor === s.cursor) return;
    this.time.dispatch({ type: "cursor", t: cursor });
    for (const c of this.client.channels.values()) if (c.at === asked.cursor) c.at = cursor;
  }

  opened(reply) {
    const origin = reply.from;
    this.time.dispatch({ type: "reset", from: 0, to: Number(reply.to - origin) });
    const asked = this.address.read(origin);
    if (asked.snap) this.client.setSnap(asked.snap);
    if (asked.view || asked.cursor != null || asked.sel) this.time.dispatch({ type: "restore", ...asked });
    if (asked.live || (reply.live && !asked.view))
      this.time.dispatch({ type: "live", on: true, width: setting("live") });
    document.body.dataset.ready = "1";
    this.header.update(this.time.get());
  }

  // The actions of the toolbar's buttons, the keys and the palette.
  act(name) {
    const s = this.time.get();
    if (name === "live" && s.mode !== "live" && !this.growing) {
      return toast("This recording has ended: there is nothing to follow live");
    }
    if ((name === "back" || name === "on" || name === "jumpBack" || name === "jumpOn") && this.client.snap) {
      return this.step(name);
    }
    const action = timeAction(name, s);
    if (action) return this.time.dispatch(action);
    commands[name]?.(this);
  }

  // Steps to the message before or after the cursor in the snapped stream, one step after the other.
  step(name) {
    this.stepping = (this.stepping ?? Promise.resolve()).then(() => this.stepOnce(name)).catch(() => {});
    return this.stepping;
  }

  async stepOnce(name) {
    const dir = name === "back" || name === "jumpBack" ? "previous" : "next";
    const to = await this.message(dir, this.time.get().cursor);
    if (to != null) this.time.dispatch({ type: "nudge", by: to - this.time.get().cursor });
  }

  // The time of the snapped stream's message before or after a time; null where there is none.
  async message(dir, t) {
    const q = new URLSearchParams({ stream: this.client.snap, at: this.client.abs(t), dir });
    const r = await fetch(`${this.options.stepUrl()}&${q}`);
    const time = r.ok ? (await r.json()).time : null;
    return time == null ? null : this.client.rel(BigInt(time));
  }

  // The time of the snapped stream's message nearest to a time, as far as one is in view; else the time itself.
  async nearest(t) {
    if (!this.client.snap) return t;
    const [from, to] = this.time.get().view;
    const found = await Promise.all([this.message("previous", t + 1), this.message("next", t)]);
    const seen = found.filter((m) => m != null && m >= from && m <= to);
    return seen.sort((a, b) => Math.abs(a - t) - Math.abs(b - t))[0] ?? t;
  }

  listen() {
    this.keydown = (e) => {
      if (e.target.closest?.("input, textarea, select, dialog") && !(e.ctrlKey && e.key === "k")) return;
      if (e.target.closest?.("button, a") && (e.key === " " || e.key === "Enter")) return;
      if (this.annotation?.press(e)) return e.preventDefault();
      const name = actionFor(e);
      if (!name) return;
      e.preventDefault();
      this.act(name);
    };
    document.addEventListener("keydown", this.keydown);
    this.keyup = (e) => this.annotation?.release(e);
    document.addEventListener("keyup", this.keyup);
    this.root.addEventListener("click", (e) => {
      // who asks for properties gets to see them
      if (e.target.closest("[phx-click='select_panel'], #tree .name"))
        document.documentElement.dataset.right = "open";
      const button = e.target.closest("[data-act]");
      if (!button) return;
      this.act(button.dataset.act);
      button.blur();
    });
    listenGoto(this.time, this.client);
    this.ticking = setInterval(() => this.tempo(), 1000);
  }

  setLayout(layout, edit, annotate) {
    const { options } = this;
    if (layout === options.layout && edit === options.edit && annotate === options.annotate) return;
    if (edit !== options.edit || layout !== options.layout) this.edited = "layout";
    Object.assign(options, { layout, edit, annotate });
    // at once: a server that comes back is told the layout by the address
    this.address.save(true);
  }

  plotPath(stream, path, kind) {
    this.options.push?.("plot_path", { stream, path, kind });
  }

  tellLanes(of, count) {
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

  tempo() {
    const fps = this.frames.rate();
    this.header.set("tempo", fps >= 1 ? `${fps.toFixed(0)} fps   ${this.client.stats.roundTrip.toFixed(0)} ms` : "");
  }

  destroy() {
    document.removeEventListener("keydown", this.keydown);
    document.removeEventListener("keyup", this.keyup);
    clearInterval(this.ticking);
    this.client.stop();
    this.menu.destroy();
    this.playback.end();
  }
}
