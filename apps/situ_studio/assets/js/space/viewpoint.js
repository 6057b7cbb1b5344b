// The viewpoint: orbiting around objects, flying, looking from above, following an object.

import { Box3, PerspectiveCamera, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const MOVES = {
  w: [1, 0, 0],
  s: [-1, 0, 0],
  a: [0, 1, 0],
  d: [0, -1, 0],
  e: [0, 0, 1],
  q: [0, 0, -1],
};
const UP = new Vector3(0, 0, 1);
// The initial direction from the scene to the viewer: behind, to the right, above.
const FROM = new Vector3(-0.72, -0.45, 0.53).normalize();

// Returns the direction to a viewer behind a camera that looks `ahead`, a little to the right and above; the default
// direction if it looks up or down.
function directionBehind(ahead) {
  const right = new Vector3().crossVectors(ahead, UP);
  if (right.length() < 0.5 * ahead.length()) return FROM;
  right.normalize();
  const back = new Vector3().crossVectors(right, UP);
  return back.addScaledVector(right, 0.28).addScaledVector(UP, 0.36).normalize();
}

export class Viewpoint {
  constructor(canvas, changed) {
    this.changed = changed;
    this.camera = new PerspectiveCamera(45, 1, 0.02, 2000);
    this.camera.up.copy(UP);
    this.camera.position.set(-4, -4, 4);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.zoomToCursor = true;
    this.orbit.target.set(2, 0, 1);
    this.orbit.addEventListener("change", () => {
      this.moved = true;
      this.updateClipping();
      changed();
    });
    this.orbit.update();
    this.moved = false;
    this.pressed = new Set();
    canvas.addEventListener("keydown", (e) => this.handleKey(e, true));
    canvas.addEventListener("keyup", (e) => this.handleKey(e, false));
    canvas.addEventListener("blur", () => this.pressed.clear());
  }

  handleKey(e, down) {
    const k = e.key.toLowerCase();
    if (!this.flying || !(k in MOVES) || e.ctrlKey || e.metaKey || e.altKey) return;
    e.stopPropagation();
    e.preventDefault();
    if (down) this.pressed.add(k);
    else this.pressed.delete(k);
    this.last ??= performance.now();
    this.changed();
  }

  // Flying rotates about the viewer, not about the target.
  setFlying(on) {
    this.flying = on;
    const way = this.viewDirection();
    const reach = on ? 0.05 : (this.reach ?? 3);
    // the speed depends on the size of the scene
    if (on) this.reach = this.camera.position.distanceTo(this.orbit.target);
    this.orbit.target.copy(this.camera.position).addScaledVector(way, reach);
    this.orbit.enableZoom = !on;
    this.orbit.rotateSpeed = on ? -0.4 : 1;
    this.orbit.update();
  }

  viewDirection() {
    return this.orbit.target.clone().sub(this.camera.position).normalize();
  }

  // Performs one step of flight; returns true while keys are pressed.
  flyStep(now = performance.now()) {
    if (!this.pressed.size) {
      this.last = null;
      return false;
    }
    const seconds = Math.min((now - (this.last ?? now)) / 1000, 0.1);
    this.last = now;
    const ahead = this.viewDirection();
    const left = new Vector3().crossVectors(UP, ahead).normalize();
    const by = new Vector3();
    for (const k of this.pressed) {
      const [x, y, z] = MOVES[k];
      by.addScaledVector(ahead, x).addScaledVector(left, y).addScaledVector(UP, z);
    }
    this.moveBy(by.multiplyScalar(Math.max(2.5, (this.reach ?? 0) / 3) * seconds));
    return true;
  }

  moveBy(by) {
    this.camera.position.add(by);
    this.orbit.target.add(by);
    this.orbit.update();
  }

  // Fits all points in view, from behind a camera that looks `ahead` if there is one, since its cloud has the fewest
  // gaps there.
  fitPoints(places, ahead) {
    const from = ahead ? directionBehind(ahead) : FROM;
    const box = new Box3();
    const all = [];
    for (const v of places) {
      box.expandByPoint(v);
      all.push(v.clone());
    }
    if (box.isEmpty()) return false;
    const middle = box.getCenter(new Vector3());
    const distance = Math.max(this.fittingDistance(all, middle, from), 0.8);
    this.camera.position.copy(middle).addScaledVector(from, distance);
    this.setTarget(middle, distance);
    this.moved = false;
    return true;
  }

  // Returns the distance from `middle` at which all points are in view with a small margin.
  fittingDistance(places, middle, from) {
    const right = new Vector3().crossVectors(UP, from).normalize();
    const up = new Vector3().crossVectors(from, right);
    const high = Math.tan((this.camera.fov * Math.PI) / 360) / 1.12;
    const wide = high * this.camera.aspect;
    const off = new Vector3();
    let most = 0;
    for (const v of places) {
      off.subVectors(v, middle);
      const needs = Math.max(Math.abs(off.dot(right)) / wide, Math.abs(off.dot(up)) / high);
      most = Math.max(most, needs + off.dot(from));
    }
    return most;
  }

  lookFromTop() {
    const { target } = this.orbit;
    const distance = Math.max(this.camera.position.distanceTo(target), 0.5);
    // slightly tilted, since left and right are undefined exactly from above: x is up
    this.camera.position.set(target.x - distance * 1e-4, target.y, target.z + distance);
    this.orbit.update();
    this.moved = true;
  }

  lookFrom(position, target) {
    this.camera.position.fromArray(position);
    const at = new Vector3().fromArray(target);
    this.setTarget(at, this.camera.position.distanceTo(at));
    this.moved = true;
  }

  setTarget(target, distance) {
    this.orbit.target.copy(target);
    this.around = { target: target.clone(), distance };
    this.orbit.update();
    this.updateClipping();
  }

  // Sets the clipping planes from the viewing distance and the distance of the last fit.
  updateClipping() {
    const { position } = this.camera;
    const looks = this.flying ? 1 : position.distanceTo(this.orbit.target);
    const away = this.around ? position.distanceTo(this.around.target) + 2 * this.around.distance : 0;
    this.camera.near = Math.max(looks / 500, 0.005);
    this.camera.far = Math.max(looks * 40, away, 200);
    this.camera.updateProjectionMatrix();
  }

  setAspect(width, height) {
    const aspect = width / height;
    if (aspect === this.camera.aspect) return;
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
  }

  close() {
    this.orbit.dispose();
  }
}
