// The keys that begin and end annotations. Pure; times are those of the page.
//
// A value's key begins an annotation at the cursor. A key held while playing ends it on release; after a short press
// the annotation stays open until the next press.

const HELD = 250;

export class KeyState {
  // attributes: [{name, kind, default, values: [{value, key}]}]
  constructor(attributes = []) {
    this.open = new Map();
    this.learn(attributes);
  }

  learn(attributes) {
    this.keys = new Map();
    for (const a of attributes)
      for (const v of a.values) if (v.key) this.keys.set(v.key, { attribute: a.name, value: v.value });
  }

  has(key) {
    return this.keys.has(key);
  }

  // Answers an annotation {from, to, values} that is complete, or null. `now` is the page's clock in ms.
  down(key, t, now) {
    if (this.open.has(key)) return this.end(key, t);
    const { attribute, value } = this.keys.get(key);
    this.open.set(key, { from: t, since: now, values: { [attribute]: value } });
    return null;
  }

  up(key, t, now) {
    const held = this.open.get(key);
    if (!held || now - held.since < HELD || t === held.from) return null;
    return this.end(key, t);
  }

  end(key, t) {
    const { from, values } = this.open.get(key);
    this.open.delete(key);
    return { from: Math.min(from, t), to: Math.max(from, t), values };
  }

  // Segments begun and not ended, up to now.
  pending(t) {
    return [...this.open.values()].map(({ from, values }) => ({
      from: Math.min(from, t),
      to: Math.max(from, t),
      values,
    }));
  }

  cancel() {
    const any = this.open.size > 0;
    this.open.clear();
    return any;
  }
}
