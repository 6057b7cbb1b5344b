// What every 3D view has: the light, the grid on the ground and the axes.

import { AxesHelper, DirectionalLight, GridHelper, HemisphereLight } from "three";

export class Ground {
  constructor(scene) {
    this.lamp = new DirectionalLight(0xffffff, 1.6);
    this.grid = new GridHelper(20, 20);
    this.grid.rotateX(Math.PI / 2);
    this.axes = new AxesHelper(1);
    scene.add(new HemisphereLight(0xffffff, 0x8a8a92, 1.5), this.lamp, this.lamp.target, this.grid, this.axes);
  }

  // Sets the size of the grid's cells and of the axes.
  setScale(metres) {
    this.grid.scale.setScalar(metres);
    this.axes.scale.setScalar(metres);
  }

  // Lets the light shine from the viewer's position.
  placeLamp(position, target) {
    this.lamp.position.copy(position);
    this.lamp.target.position.copy(target);
  }

  setColor(color) {
    const material = /** @type {import("three").LineBasicMaterial} */ (this.grid.material);
    material.vertexColors = false;
    material.color.set(color);
    material.needsUpdate = true;
  }

  dispose() {
    this.grid.dispose();
    this.axes.dispose();
  }
}
