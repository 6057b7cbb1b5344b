// One stream of a panel: its items as objects of the scene, rebuilt when the message or the properties change.

import { Group, Matrix4, Vector3 } from "three";
import { buildPoints } from "./build/points.js";
import { buildBoxes, buildGraphs, buildLines, buildVoxels } from "./build/solids.js";
import { buildFrusta, buildMeshes, buildQuads } from "./build/surfaces.js";
import { buildTexts } from "./build/texts.js";

const BUILD = {
  points: buildPoints,
  lines: buildLines,
  boxes: buildBoxes,
  meshes: buildMeshes,
  quads: buildQuads,
  frusta: buildFrusta,
  graphs: buildGraphs,
  voxels: buildVoxels,
  texts: buildTexts,
};

// Draws an object over everything in front of it.
function drawOnTop(object) {
  object.renderOrder = 10;
  if (object.material) Object.assign(object.material, { depthTest: false, transparent: true });
}

export class Layer {
  // uploaded() is called after an image was uploaded in the background
  constructor(uploaded) {
    this.uploaded = uploaded;
    this.group = new Group();
    this.group.matrixAutoUpdate = false;
    /** @type {any[]} */
    this.parts = [];
    this.texts = [];
    /** @type {string | null} why the layer cannot be placed */
    this.unplaced = null;
  }

  // content: {name, short, props, own, frame}; pixels: screen pixels per page pixel
  fill(content, pixels) {
    this.clear();
    Object.assign(this, content);
    const props = { ...content.props, owned: content.own };
    for (const item of content.frame?.items ?? []) {
      // drawn over the 3D view, unless there is no canvas for it
      if (item.kind === "texts" && !props.signs) this.texts.push(item);
      else if (item.count && BUILD[item.kind]) this.addItem(item, props, pixels);
    }
  }

  addItem(item, props, pixels) {
    const part = BUILD[item.kind](item, props, pixels, this.uploaded);
    part.item = item;
    this.group.add(part.object);
    if (props.over) part.object.traverse(drawOnTop);
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

  setMatrix(matrix) {
    this.group.matrix.copy(matrix ?? new Matrix4());
    this.group.matrixWorldNeedsUpdate = true;
  }

  get problem() {
    return this.unplaced ?? this.parts.find((p) => p.item.problem)?.item.problem ?? null;
  }

  // Yields positions of the layer's items for the initial view; a sample of large items.
  *samplePoints() {
    const v = new Vector3();
    for (const { item } of this.parts) {
      if (item.kind === "boxes") {
        for (let i = 0; i < item.count; i++)
          yield v.fromArray(item.matrix, 16 * i + 12).applyMatrix4(this.group.matrix);
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

  // Returns the center of the layer, which the view can follow.
  centerPoint() {
    const sum = new Vector3();
    let n = 0;
    for (const v of this.samplePoints()) {
      sum.add(v);
      n++;
    }
    return n ? sum.divideScalar(n) : null;
  }
}
