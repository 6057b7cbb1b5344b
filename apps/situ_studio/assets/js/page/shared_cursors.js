// Shares cursors between browsers that show the same recording. Users who share their position are visible to the
// others, who may follow them. The server relays messages and stores nothing.

import { readAnnotator } from "../annotation/annotator.js";
import { GUTTER, seriesColor } from "./theme.js";
import { showToast } from "./toast.js";
import { closestTarget } from "./dom.js";

// The minimum interval between messages in ms, the interval while nothing moves, and the time after which a silent
// peer is removed.
const PACE = 100,
  ALIVE = 2000,
  LOST = 6000;

export class SharedCursors {
  constructor(app) {
    this.app = app;
    this.who = Math.random().toString(36).slice(2, 12);
    this.peers = new Map();
    this.sharing = false;
    this.following = null;
    this.el = document.getElementById("together");
    this.el?.addEventListener("click", (e) => this.followPeer(closestTarget(e, "button")?.dataset.who));
    app.time.subscribe((s, old, action) => this.handleMove(action));
    this.timer = setInterval(() => this.sendAlive(), ALIVE);
  }

  // Starts or stops sharing this page's position.
  toggleSharing() {
    this.sharing = !this.sharing;
    this.pushState(!this.sharing);
    this.showPeers();
    showToast(this.sharing ? "Others now see your cursor" : "You stopped sharing your cursor");
  }

  // A user who moves the view or the cursor stops following.
  handleMove(action) {
    if (this.following && !this.applying && ["view", "pan", "zoomAt", "nudge", "seek", "goto"].includes(action?.type))
      this.followPeer(null);
    if (!this.sharing || this.waiting) return;
    this.waiting = setTimeout(() => {
      this.waiting = null;
      this.pushState();
    }, PACE);
    this.drawCursors();
  }

  pushState(gone = false) {
    const { client, time, options } = this.app;
    if (client.origin === null) return;
    const s = time.get();
    options.push?.("together", {
      who: this.who,
      name: readAnnotator() ?? `Guest ${this.who.slice(0, 3)}`,
      cursor: client.toAbsolute(s.cursor),
      view: s.view.map((t) => client.toAbsolute(t)),
      live: s.mode === "live",
      gone,
    });
  }

  sendAlive() {
    if (this.sharing) this.pushState();
    const now = performance.now();
    for (const [who, p] of this.peers) if (now - p.heard > LOST) this.removePeer(who);
  }

  receivePeer(message) {
    if (message.gone) return this.removePeer(message.who);
    const { client, time } = this.app;
    if (client.origin === null) return;
    const toRelative = (t) => client.toRelative(BigInt(t));
    const known = this.peers.get(message.who);
    const color = known?.color ?? seriesColor(null, this.peers.size + 1);
    const peer = {
      ...message,
      color,
      cursor: toRelative(message.cursor),
      view: message.view.map(toRelative),
      heard: performance.now(),
    };
    this.peers.set(message.who, peer);
    if (known?.name !== message.name) this.showPeers();
    if (this.following === message.who) {
      this.applying = true;
      if (peer.live && this.app.growing) time.dispatch({ type: "live", on: true });
      else {
        time.dispatch({ type: "view", from: peer.view[0], to: peer.view[1] });
        time.dispatch({ type: "nudge", by: peer.cursor - time.get().cursor });
      }
      this.applying = false;
    }
    this.drawCursors();
  }

  removePeer(who) {
    if (!this.peers.delete(who)) return;
    if (this.following === who) this.following = null;
    this.showPeers();
    this.drawCursors();
  }

  followPeer(who) {
    this.following = who && this.following !== who ? who : null;
    this.showPeers();
    const peer = this.peers.get(this.following);
    if (peer)
      this.receivePeer({
        ...peer,
        cursor: this.app.client.toAbsolute(peer.cursor),
        view: peer.view.map((t) => this.app.client.toAbsolute(t)),
      });
  }

  // Lists the peers in the status line; a click follows one.
  showPeers() {
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

  // Draws the peers' cursors over every timeline.
  drawCursors() {
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
    if (this.sharing) this.pushState(true);
  }
}
