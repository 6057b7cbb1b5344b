// Keeps the page's address in sync with what is shown, so that a copied link restores it.

import * as link from "../time/link.js";

const SETTLED = 200;

export class Address {
  // facts() -> {layout, edit, snap}; moved(href) is called after a change; the address of a file is fixed
  constructor({ time, client, facts, moved, fixed = false }) {
    this.fixed = fixed;
    this.time = time;
    this.client = client;
    this.facts = facts;
    this.moved = moved;
  }

  readLink(origin) {
    return link.decodeLink(location.search, origin);
  }

  save(now = false) {
    if (this.client.origin === null || this.fixed) return;
    clearTimeout(this.timer);
    const writeAddress = () => {
      const q = link.encodeLink(this.time.get(), this.client.origin, this.facts());
      history.replaceState(history.state, "", `${location.pathname}?${q}`);
      this.moved?.(location.href);
    };
    if (now) writeAddress();
    else this.timer = setTimeout(writeAddress, SETTLED);
  }
}
