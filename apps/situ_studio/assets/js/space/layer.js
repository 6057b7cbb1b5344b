// One stream of a panel: its items as objects of the scene, made anew when the message or the looks have changed.

import { Group, Matrix4, Vector3 } from "three";
import { points } from "./build/points.js";
import { boxes, graphs, lines, voxels } from "./build/solids.js";
import { frusta, meshes, quads } from "./build/surfaces.js";
import { texts } from "./build/texts.js";

const BUILD = { points, lines, boxes, meshes, quads, frusta, graphs, voxels, texts };

// Seen through whatever stands before it.
function over(object) {
  object.renderOrder = 10;
  if (object.material) Object.assign(object.material, { depthTest: false, transparent: true });
}

export class Layer {
  // uploaded(): a picture that took its time has come
  constructor(uploaded) {
    this.uploaded = uploaded;
    this.group = new Group();
    this.group.matrixAutoUpdate = false;
    this.parts = [];
    this.texts = [];
  }

  // told: {name, short, props, own, frame}; pixels: of the screen for one of the page
  fill(told, pixels) {
    this.clear();
    Object.assign(this, told);
    const props = { ...told.props, owned: told.own };
    for (const item of told.frame?.items ?? []) {
      // drawn over the picture, unless there is nothing to draw on
      if (item.kind === "texts" && !props.signs) this.texts.push(item);
      else if (item.count && BUILD[item.kind]) this.add(item, props, pixels);
    }
  }

  add(item, props, pixels) {
    const part = BUILD[item.kind](item, props, pixels, this.uploaded);
    part.item = item;
    this.group.add(part.object);
    if (props.over) part.object.traverse(over);
    this.parts.push(part);
  }

  clear() {
    for (const { object } of this.parts) {
      this.group.remove(object);
      object.traverse((o) => {
        o.geometry?.dispose();
        o.dispose?.();
        for (const m of [o.material].flat().filter(Boolean)) {
          m.gone = true;
          m.map?.image?.close?.();
          m.map?.dispose();
          m.dispose();
        }
      });
    }
    this.parts = [];
    this.texts = [];
  }

  place(matrix) {
    this.group.matrix.copy(matrix ?? new Matrix4());
    this.group.matrixWorldNeedsUpdate = true;
  }

  get problem() {
    return this.unplaced ?? this.parts.find((p) => p.item.problem)?.item.problem ?? null;
  }

  // Where its things lie, for the first look at them: every number of its items, and of many a sample.
  *places() {
    const v = new Vector3();
    for (const { item } of this.parts) {
      if (item.kind === "boxes") {
        for (let i = 0; i < item.count; i++)
          yield v.set(...item.matrix.slice(16 * i + 12, 16 * i + 15)).applyMatrix4(this.group.matrix);
        continue;
      }
      const numbers = item.position ?? item.corner;
      const own = item.matrix ? new Matrix4().fromArray(item.matrix) : null;
      const step = 3 * Math.max(1, Math.floor(numbers.length / 3 / 2000));
      for (let i = 0; i + 2 < numbers.length; i += step) {
        v.set(numbers[i], numbers[i + 1], numbers[i + 2]);
        if (own) v.applyMatrix4(own);
        if (Number.isFinite(v.x + v.y + v.z)) yield v.applyMatrix4(this.group.matrix);
      }
    }
  }

  // The middle of its things, which a view can follow.
  middle() {
    const sum = new Vector3();
    let n = 0;
    for (const v of this.places()) {
      sum.add(v);
      n++;
    }
    return n ? sum.divideScalar(n) : null;
  }
}
