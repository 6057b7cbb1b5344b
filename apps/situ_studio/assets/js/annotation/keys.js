// Tracks the keys that begin and end annotations. Pure; times are relative to the page's origin.
//
// The key of a value begins an annotation at the cursor. If it is held during playback, releasing it ends the
// annotation. After a short press, the annotation stays open until the key is pressed again.

const HELD = 250;

export class KeyState {
  // attributes: [{name, kind, default, values: [{value, key}]}]
  constructor(attributes = []) {
    /** @type {Map<string, {from: number, since: number, values: object}>} the open annotations by key */
    this.open = new Map();
    /** @type {Map<string, {attribute: string, value: string}>} */
    this.keys = new Map();
    this.setAttributes(attributes);
  }

  setAttributes(attributes) {
    this.keys = new Map();
    for (const a of attributes)
      for (const v of a.values) if (v.key) this.keys.set(v.key, { attribute: a.name, value: v.value });
  }

  has(key) {
    return this.keys.has(key);
  }

  // Returns a complete annotation {from, to, values}, or null. `now` is the page's clock in ms.
  pressKey(key, t, now) {
    if (this.open.has(key)) return this.endAnnotation(key, t);
    const chosen = this.keys.get(key);
    if (chosen) this.open.set(key, { from: t, since: now, values: { [chosen.attribute]: chosen.value } });
    return null;
  }

  releaseKey(key, t, now) {
    const held = this.open.get(key);
    if (!held || now - held.since < HELD || t === held.from) return null;
    return this.endAnnotation(key, t);
  }

  endAnnotation(key, t) {
    const begun = this.open.get(key);
    if (!begun) return null;
    const { from, values } = begun;
    this.open.delete(key);
    return { from: Math.min(from, t), to: Math.max(from, t), values };
  }

  // Returns the open annotations, extended to time `t`.
  pendingAnnotations(t) {
    return [...this.open.values()].map(({ from, values }) => ({
      from: Math.min(from, t),
      to: Math.max(from, t),
      values,
    }));
  }

  cancelOpen() {
    const any = this.open.size > 0;
    this.open.clear();
    return any;
  }
}
