// Several browsers on one recording: who shares where they look is seen by the others, who may follow. The server
// passes on and keeps nothing.

import { annotator } from "../annotation/annotator.js";
import { GUTTER, seriesColor } from "./theme.js";
import { toast } from "./toast.js";

// At most so often, in ms; and so often while nothing moves, so that who has gone is noticed.
const PACE = 100,
  ALIVE = 2000,
  LOST = 6000;

export class Together {
  constructor(app) {
    this.app = app;
    this.who = Math.random().toString(36).slice(2, 12);
    this.peers = new Map();
    this.sharing = false;
    this.following = null;
    this.el = document.getElementById("together");
    this.el?.addEventListener("click", (e) => this.follow(e.target.closest("button")?.dataset.who));
    app.time.subscribe((s, old, action) => this.moved(action));
    this.timer = setInterval(() => this.tick(), ALIVE);
  }

  // Shares where this page looks, or no longer.
  toggle() {
    this.sharing = !this.sharing;
    this.tell(!this.sharing);
    this.show();
    toast(this.sharing ? "Others who look at this see your cursor" : "Your cursor is yours again");
  }

  // Whoever moves by themselves no longer follows.
  moved(action) {
    if (this.following && !this.applying && ["view", "pan", "zoomAt", "nudge", "seek", "goto"].includes(action?.type))
      this.follow(null);
    if (!this.sharing || this.waiting) return;
    this.waiting = setTimeout(() => {
      this.waiting = null;
      this.tell();
    }, PACE);
    this.draw();
  }

  tell(gone = false) {
    const { client, time, options } = this.app;
    if (client.origin === null) return;
    const s = time.get();
    options.push?.("together", {
      who: this.who,
      name: annotator() ?? `Guest ${this.who.slice(0, 3)}`,
      cursor: client.abs(s.cursor),
      view: s.view.map((t) => client.abs(t)),
      live: s.mode === "live",
      gone,
    });
  }

  tick() {
    if (this.sharing) this.tell();
    const now = performance.now();
    for (const [who, p] of this.peers) if (now - p.heard > LOST) this.left(who);
  }

  heard(told) {
    if (told.gone) return this.left(told.who);
    const { client, time } = this.app;
    if (client.origin === null) return;
    const rel = (t) => client.rel(BigInt(t));
    const known = this.peers.get(told.who);
    const color = known?.color ?? seriesColor(null, this.peers.size + 1);
    const peer = { ...told, color, cursor: rel(told.cursor), view: told.view.map(rel), heard: performance.now() };
    this.peers.set(told.who, peer);
    if (known?.name !== told.name) this.show();
    if (this.following === told.who) {
      this.applying = true;
      if (peer.live && this.app.growing) time.dispatch({ type: "live", on: true });
      else {
        time.dispatch({ type: "view", from: peer.view[0], to: peer.view[1] });
        time.dispatch({ type: "nudge", by: peer.cursor - time.get().cursor });
      }
      this.applying = false;
    }
    this.draw();
  }

  left(who) {
    if (!this.peers.delete(who)) return;
    if (this.following === who) this.following = null;
    this.show();
    this.draw();
  }

  follow(who) {
    this.following = who && this.following !== who ? who : null;
    this.show();
    const peer = this.peers.get(this.following);
    if (peer)
      this.heard({
        ...peer,
        cursor: this.app.client.abs(peer.cursor),
        view: peer.view.map((t) => this.app.client.abs(t)),
      });
  }

  // Who is there, in the status line: a click follows.
  show() {
    if (!this.el) return;
    this.el.textContent = this.sharing ? "sharing " : "";
    for (const [who, { name, color }] of this.peers) {
      const b = this.el.appendChild(document.createElement("button"));
      Object.assign(b, { type: "button", className: "linkish", textContent: name });
      b.dataset.who = who;
      b.style.borderBottom = `2px solid ${color}`;
      b.setAttribute("aria-pressed", String(this.following === who));
      b.title = this.following === who ? `Following ${name}; click to stop` : `Follow ${name}`;
    }
  }

  // Their cursors over every timeline.
  draw() {
    const { view } = this.app.time.get();
    for (const o of this.app.frames.overlays.values()) {
      const inner = o.el.clientWidth - GUTTER.left - GUTTER.right;
      o.others ??= new Map();
      for (const [who, line] of o.others) if (!this.peers.has(who)) (line.remove(), o.others.delete(who));
      for (const [who, { cursor, color, name }] of this.peers) {
        let line = o.others.get(who);
        if (!line) {
          line = o.box.appendChild(document.createElement("div"));
          line.className = "cursor-line other";
          o.others.set(who, line);
        }
        const x = ((cursor - view[0]) / (view[1] - view[0])) * inner;
        line.hidden = !(x >= 0 && x <= inner);
        line.style.background = color;
        line.style.transform = `translateX(${x}px)`;
        line.dataset.name = name;
      }
    }
  }

  destroy() {
    clearInterval(this.timer);
    if (this.sharing) this.tell(true);
  }
}
