// Finds the object under the mouse: its layer, its index, and the point hit.

import { Plane, Raycaster, Vector2, Vector3 } from "three";

const GROUND = new Plane(new Vector3(0, 0, 1), 0);
// Clouds with more points are not searched while the mouse moves.
const MOST = 3_000_000;

/**
 * @typedef {object} Hit
 * @property {import("./layer.js").Layer} layer
 * @property {any} part
 * @property {number} index
 * @property {import("three").Object3D} object
 * @property {Vector3} point
 * @property {number} rank
 */

export class Pointer {
  constructor(canvas, view) {
    this.canvas = canvas;
    this.view = view;
    this.camera = view.camera;
    this.caster = new Raycaster();
  }

  aimRay(x, y) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.caster.setFromCamera(new Vector2((x / w) * 2 - 1, 1 - (y / h) * 2), this.camera);
  }

  // Returns the nearest item at a position of the canvas, {layer, part, index, object, point}, or null.
  hitAt(layers, x, y) {
    this.aimRay(x, y);
    /** @type {Hit | null} */
    let best = null;
    for (const layer of layers) {
      if (!layer.group.visible) continue;
      for (const part of layer.parts) {
        if (part.item.kind === "points" && part.item.count > MOST) continue;
        this.setReach(part.item);
        for (const hit of this.caster.intersectObject(part.object, true)) {
          const { point } = hit;
          const object = /** @type {import("three").Mesh} */ (hit.object);
          const index = hit.instanceId ?? hit.index ?? 0;
          if ([object.material].flat().some((material) => material?.visible === false)) continue;
          // points and lines are ranked by their distance to the mouse before their distance to the viewer
          const rank = hit.distance + (hit.distanceToRay ?? 0) * 50;
          if (!best || rank < best.rank) best = { layer, part, index, object, point: point.clone(), rank };
          if (part.item.kind !== "points") break;
        }
      }
    }
    return best;
  }

  // Sets the hit distance to a few screen pixels at the distance of the view's target.
  setReach(item) {
    const metres = (2 * Math.tan((this.camera.fov * Math.PI) / 360)) / this.canvas.clientHeight;
    const { flying, reach, orbit } = this.view;
    const far = (flying ? (reach ?? 3) : this.camera.position.distanceTo(orbit.target)) || 1;
    const pixels = item.kind === "points" ? 4 : 3;
    this.caster.params.Points.threshold = Math.max(metres * pixels * far, 0.002);
    this.caster.params.Line.threshold = Math.max(metres * pixels * far, 0.002);
  }

  // Returns the point of the ground at a position of the canvas, or null.
  groundAt(x, y) {
    this.aimRay(x, y);
    return this.caster.ray.intersectPlane(GROUND, new Vector3());
  }
}
