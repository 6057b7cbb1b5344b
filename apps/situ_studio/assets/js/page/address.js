// Keeps the page's address in step with what is shown, so that a copied link shows the same.

import * as link from "../time/link.js";

const SETTLED = 200;

export class Address {
  // facts() -> {layout, edit, snap}; moved(href) when it has changed
  constructor({ time, client, facts, moved }) {
    Object.assign(this, { time, client, facts, moved });
  }

  read(origin) {
    return link.decode(location.search, origin);
  }

  save(now = false) {
    if (this.client.origin === null) return;
    clearTimeout(this.timer);
    const save = () => {
      const q = link.encode(this.time.get(), this.client.origin, this.facts());
      history.replaceState(history.state, "", `${location.pathname}?${q}`);
      this.moved?.(location.href);
    };
    if (now) save();
    else this.timer = setTimeout(save, SETTLED);
  }
}
