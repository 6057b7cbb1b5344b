// One page: the time, the data socket, and everything that draws. Knows nothing of LiveView; `app.js` connects both.

import { createStore } from "./time_view.js";
import { DataClient } from "./data_client.js";
import { Playback } from "./playback.js";
import { Overlay } from "./overlay.js";
import { timelineGestures } from "./gestures.js";
import { actionFor, timeAction } from "./keys.js";
import { Header } from "./header.js";
import { listenGoto } from "./dialogs.js";
import { Connection } from "./connection.js";
import { commands } from "./commands.js";
import { onTheme } from "./theme.js";
import * as link from "./link.js";
import { decode, KIND } from "./wire.js";

export class Studio {
  // options: {dataUrl, pcmUrl, source, token, layout, push}
  constructor(root, options) {
    Object.assign(this, { root, options });
    this.time = createStore();
    this.views = new Set();
    this.dirty = new Set();
    this.overlays = new Map();
    this.frames = { count: 0, last: performance.now() };
    this.client = new DataClient({
      connect: () => new WebSocket(options.dataUrl),
      time: this.time,
      onStatus: (s) => this.connection.set(s),
      onReply: (r) => this.replied(r),
    });
    this.playback = new Playback({
      time: this.time,
      sounds: () => this.sounds(),
      fetchPcm: (x, a, b) => this.fetchPcm(x, a, b),
      onError: (text) => this.toast(text),
    });
    this.header = new Header(root, () => this.client.origin);
    this.connection = new Connection(this.header, (text) => this.toast(text));
    this.time.subscribe((s, old) => this.changed(s, old));
    onTheme(() => {
      for (const v of this.views) v.themeChanged?.();
    });
    this.listen();
    this.client.start();
  }

  // A view has render() and, when it draws times, cursorMoved(); `timeline` views get cursor and selection lines.
  add(view, { timeline = false, gestures = timeline } = {}) {
    this.views.add(view);
    if (timeline) {
      const o = new Overlay(view.el, this);
      this.overlays.set(view, o);
      o.update(this.time.get());
    }
    if (gestures) timelineGestures(view.el, this);
    view.timeline = timeline;
    this.schedule(view);
  }

  remove(view) {
    this.views.delete(view);
    this.dirty.delete(view);
    this.overlays.delete(view);
    view.destroy?.();
  }

  schedule(view) {
    this.dirty.add(view);
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = null;
      const views = [...this.dirty];
      this.dirty.clear();
      for (const v of views) if (this.views.has(v)) v.render();
      this.frames.count++;
    });
  }

  changed(s, old) {
    const viewChanged = s.view !== old.view || s.data !== old.data;
    for (const o of this.overlays.values()) o.update(s);
    for (const v of this.views) {
      if (v.timeline && viewChanged) this.schedule(v);
      else if (s.cursor !== old.cursor) v.cursorMoved();
      if (v.navigator) this.schedule(v);
    }
    this.header.update(s);
    this.client.pump();
    this.saveLink();
    if (s.mode !== old.mode) document.body.dataset.mode = s.mode;
  }

  replied(reply) {
    if (reply.first) this.opened(reply);
    if (this.growing !== reply.live) {
      this.growing = reply.live;
      this.header.grows(reply.live);
      document.body.dataset.growing = reply.live ? "1" : "";
    }
    this.connection.set(reply.gone ? "gone" : "open");
    const s = this.time.get();
    // a snapped cursor moves to where the server found the message
    if (reply.asked?.message.snap && s.mode === "manual" && s.cursor === reply.asked.cursor && reply.cursor !== s.cursor) {
      this.time.dispatch({ type: "cursor", t: reply.cursor });
      for (const c of this.client.channels.values()) if (c.at === reply.asked.cursor) c.at = reply.cursor;
    }
    if (this.catalog !== undefined && this.catalog !== reply.version) this.options.push?.("streams_changed", {});
    this.catalog = reply.version;
  }

  opened(reply) {
    const origin = reply.from;
    this.time.dispatch({ type: "reset", from: 0, to: Number(reply.to - origin) });
    const asked = link.decode(location.search, origin);
    if (asked.snap) this.client.setSnap(asked.snap);
    if (asked.view || asked.cursor != null || asked.sel) this.time.dispatch({ type: "restore", ...asked });
    if (asked.live || (reply.live && !asked.view)) this.time.dispatch({ type: "live", on: true });
    document.body.dataset.ready = "1";
    this.header.update(this.time.get());
  }

  // What the toolbar's buttons, the keys and the palette do.
  act(name) {
    const s = this.time.get();
    if (name === "live" && s.mode !== "live" && !this.growing) {
      return this.toast("Nothing is being recorded here: there is nothing to follow live");
    }
    if ((name === "back" || name === "on" || name === "jumpBack" || name === "jumpOn") && this.client.snap) {
      return this.step(name);
    }
    const action = timeAction(name, s);
    if (action) return this.time.dispatch(action);
    commands[name]?.(this);
  }

  // Steps to the message before or after the cursor in the snapped stream.
  async step(name) {
    const dir = name === "back" || name === "jumpBack" ? "previous" : "next";
    const q = new URLSearchParams({ stream: this.client.snap, at: this.client.abs(this.time.get().cursor), dir });
    const r = await fetch(`${this.options.stepUrl}&${q}`);
    if (!r.ok) return;
    const t = (await r.json()).time;
    if (t != null) {
      const to = this.client.rel(BigInt(t));
      this.time.dispatch({ type: "nudge", by: to - this.time.get().cursor });
    }
  }

  async copy(text, done, refused = text) {
    try {
      await navigator.clipboard.writeText(text);
      this.toast(done);
    } catch {
      this.toast(refused);
    }
  }

  listen() {
    this.keydown = (e) => {
      if (e.target.closest?.("input, textarea, select, dialog") && !(e.ctrlKey && e.key === "k")) return;
      if (e.target.closest?.("button, a") && (e.key === " " || e.key === "Enter")) return;
      const name = actionFor(e);
      if (!name) return;
      e.preventDefault();
      this.act(name);
    };
    document.addEventListener("keydown", this.keydown);
    this.root.addEventListener("click", (e) => {
      // who asks for properties gets to see them
      if (e.target.closest("[phx-click='select_panel'], #tree .name")) document.documentElement.dataset.right = "open";
      const button = e.target.closest("[data-act]");
      if (!button) return;
      this.act(button.dataset.act);
      button.blur();
    });
    listenGoto(this.time, () => this.client.origin);
    this.ticking = setInterval(() => this.tempo(), 1000);
  }

  saveLink(now = false) {
    if (this.client.origin === null) return;
    clearTimeout(this.linkTimer);
    const save = () => {
      const q = link.encode(this.time.get(), this.client.origin, { ...this.options, snap: this.client.snap });
      history.replaceState(history.state, "", `${location.pathname}?${q}`);
      this.options.moved?.(location.href);
    };
    if (now) save();
    else this.linkTimer = setTimeout(save, 200);
  }

  setLayout(layout, edit) {
    if (layout === this.options.layout && edit === this.options.edit) return;
    Object.assign(this.options, { layout, edit });
    // at once: a server that comes back is told the layout by the address
    this.saveLink(true);
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
    this.saveLink(true);
  }

  // Waveforms that are shown are heard, unless muted.
  sounds() {
    const out = new Map();
    for (const v of this.views) {
      for (const l of v.layers ?? []) {
        if (l.vis.draw !== "waveform" || l.vis.props?.mute || l.vis.props?.visible === false) continue;
        out.set(l.vis.stream, { stream: l.vis.stream, channel: l.vis.channel ?? 0 });
      }
    }
    return [...out.values()].slice(0, 4);
  }

  async fetchPcm(sound, from, to) {
    const q = new URLSearchParams({
      stream: sound.stream, channel: sound.channel, from: this.client.abs(from), to: this.client.abs(to),
    });
    const response = await fetch(`${this.options.pcmUrl}&${q}`);
    if (!response.ok) throw new Error(await response.text());
    const f = decode(await response.arrayBuffer()).frames[0];
    if (!f || f.kind !== KIND.pcm) return null;
    return { rate: f.rate, samples: f.samples, at: this.client.rel(f.time) };
  }

  tempo() {
    const now = performance.now();
    const fps = (this.frames.count * 1000) / (now - this.frames.last);
    this.fps = fps;
    this.frames = { count: 0, last: now };
    this.header.set("tempo", fps >= 1 ? `${fps.toFixed(0)} fps   ${this.client.stats.roundTrip.toFixed(0)} ms` : "");
  }

  toast(text) {
    const el = document.getElementById("toast");
    if (!el) return;
    el.textContent = text;
    el.classList.add("on");
    clearTimeout(this.toastTimer);
    this.toastTimer = setTimeout(() => el.classList.remove("on"), 4000);
  }

  destroy() {
    document.removeEventListener("keydown", this.keydown);
    clearInterval(this.ticking);
    this.client.stop();
    this.playback.end();
  }
}
