// One 3D panel: its layers in one scene, the viewer in it, and the tools.

import {
  AxesHelper,
  Color,
  DirectionalLight,
  Frustum,
  GridHelper,
  HemisphereLight,
  Matrix4,
  Scene,
  Vector3,
} from "three";
import { paint, memory } from "./renderer.js";
import { Layer } from "./layer.js";
import { Tree } from "./frames.js";
import { Viewpoint } from "./viewpoint.js";
import { Pointer } from "./pointer.js";
import { drawMeasure, drawScales, drawTexts, project } from "./overlay.js";
import { counted, describe, thinned } from "./words.js";

// Of a cloud that is drawn in part: the points of what is seen, in a layer of their own.
const near = (key) => `${key} near`;

export const openStage = (canvas, told) => new Stage(canvas, told);

class Stage {
  // changed(): draw again; pointed(lines, x, y): what lies under the mouse; theme(): the page's colours
  constructor(canvas, { changed, pointed, theme }) {
    Object.assign(this, { canvas, changed, pointed, theme });
    this.scene = new Scene();
    this.view = new Viewpoint(canvas, changed);
    this.pointer = new Pointer(canvas, this.view);
    this.layers = new Map();
    this.trees = new Map();
    this.on = new Set();
    this.measured = [];
    this.pixels = devicePixelRatio;
    this.lights();
    this.listen();
    if (!canvas.getContext("2d")) throw new Error("this browser gives no canvas");
  }

  lights() {
    this.lamp = new DirectionalLight(0xffffff, 1.6);
    this.scene.add(new HemisphereLight(0xffffff, 0x8a8a92, 1.5), this.lamp, this.lamp.target);
    this.grid = new GridHelper(20, 20);
    this.grid.rotateX(Math.PI / 2);
    this.axes = new AxesHelper(1);
    this.scene.add(this.grid, this.axes);
  }

  listen() {
    const on = (name, f) => this.canvas.addEventListener(name, f);
    let down = null;
    on("pointermove", (e) => {
      this.mouse = e.buttons ? null : [e.offsetX, e.offsetY, e.clientX, e.clientY];
      this.hover();
    });
    on("pointerleave", () => {
      this.mouse = null;
      this.pointed([]);
    });
    on("pointerdown", (e) => (down = [e.offsetX, e.offsetY]));
    on("pointerup", (e) => {
      if (down && Math.hypot(e.offsetX - down[0], e.offsetY - down[1]) < 4) this.click(e.offsetX, e.offsetY);
      down = null;
    });
    on("dblclick", () => this.use("fit"));
  }

  // A layer as the panel tells it: its message, its looks. Trees of frames place the others.
  put(key, told) {
    const layer = this.layers.get(key) ?? this.open(key);
    layer.group.visible = told.props.visible !== false;
    const frame = told.frame;
    if (frame?.value?.frames) this.trees.set(key, { told: frame.value.frames, props: told.props });
    else this.trees.delete(key);
    const looks = JSON.stringify([told.props, told.name, this.trees.has(key)]);
    if (told.changed || looks !== layer.looks) {
      layer.looks = looks;
      layer.told = told;
      if (!this.trees.has(key)) layer.fill(told, this.pixels);
    }
    this.arrange();
  }

  open(key) {
    const layer = new Layer(this.changed);
    this.layers.set(key, layer);
    this.scene.add(layer.group);
    return layer;
  }

  // The planes around what is seen, in a layer's own frame, where of its clouds only a part is drawn; else null.
  sees(key) {
    const layer = this.layers.get(key);
    if (!layer?.group.visible || !layer.parts.some(thinned)) return null;
    const { camera } = this.view;
    camera.updateMatrixWorld();
    const all = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    const { planes } = new Frustum().setFromProjectionMatrix(all.multiply(layer.group.matrix));
    return planes.flatMap(({ normal, constant }) => [normal.x, normal.y, normal.z, constant]);
  }

  // Draws the points of what is seen beside the layer's own, or in their place while nothing moves.
  refine(key, frame) {
    const layer = this.layers.get(key);
    if (!frame) return this.remove(near(key));
    if (!layer) return;
    const scale = layer.parts.find((p) => p.scale)?.scale;
    const range = scale ? { range: "fixed", low: scale.span[0], high: scale.span[1] } : {};
    this.put(near(key), { ...layer.told, props: { ...layer.told.props, ...range }, frame, changed: true });
    this.layers.get(near(key)).near = true;
    this.alone(key, true);
  }

  alone(key, on) {
    const drawn = this.layers.has(near(key));
    for (const part of this.layers.get(key)?.parts ?? []) part.object.visible = !(on && drawn && thinned(part));
  }

  remove(key) {
    const layer = this.layers.get(key);
    this.trees.delete(key);
    if (this.layers.has(near(key))) this.remove(near(key));
    if (!layer) return;
    layer.clear();
    this.scene.remove(layer.group);
    this.layers.delete(key);
    if (this.followed?.layer === layer) this.followed = null;
    this.arrange();
  }

  // Places every layer in the fixed frame, and follows what is followed.
  arrange() {
    const [first] = this.trees.values();
    const tree = new Tree(first?.told, first?.props.fixed);
    for (const [key, layer] of this.layers) {
      if (this.trees.has(key)) {
        const { props } = this.trees.get(key);
        const items = tree.scene(props.axis ?? 0.3);
        layer.fill({ ...layer.told, frame: { items } }, this.pixels);
        continue;
      }
      const { matrix, problem } = tree.to(layer.props?.frame);
      layer.unplaced = problem ?? null;
      layer.group.visible = layer.props?.visible !== false && !problem;
      layer.place(matrix);
    }
    this.follow();
    this.changed();
  }

  follow() {
    const f = this.followed;
    const now = f && this.on.has("follow") && f.layer.middle();
    if (!now) return;
    if (f.was) this.view.shift(now.clone().sub(f.was));
    f.was = now;
  }

  problem(key) {
    return this.layers.get(key)?.problem ?? null;
  }

  // How much of what there is is drawn, in words; nothing where all of it is.
  says() {
    const parts = [...this.layers.values()].flatMap((l) => (l.group.visible && !l.near ? l.parts : []));
    const [shown, all] = counted(parts);
    if (!all) return "";
    const [close, here] = counted(
      [...this.layers.values()].flatMap((l) => (l.group.visible && l.near ? l.parts : [])),
    );
    const k = (n) => n.toLocaleString("en-US");
    const seen = here ? `; seen from here ${close < here ? `${k(close)} of ` : "all "}${k(here)}` : "";
    return (shown < all ? `${k(shown)} of ${k(all)} points` : `${k(all)} points`) + seen;
  }

  // A tool of the bar; answers which are switched on.
  use(name) {
    if (name === "fit") this.fit();
    else if (name === "top") this.view.top();
    else if (this.on.has(name)) this.on.delete(name);
    else this.on.add(name);
    if (name === "fly") this.view.fly(this.on.has("fly"));
    if (name === "measure") this.measured = [];
    if (name === "follow" && this.followed) this.followed.was = this.followed.layer.middle();
    if (name === "fly") this.canvas.focus();
    this.changed();
    return [...this.on];
  }

  // The first look: at everything, and again when more of it has come, until the viewer moves.
  look() {
    const filled = [...this.layers].filter(([, l]) => l.parts.length && !l.near).map(([key]) => key);
    const known = this.looked ?? new Set();
    if (filled.every((key) => known.has(key)) || (this.looked && this.view.moved)) return;
    if (this.fit()) this.looked = new Set(filled);
  }

  // Everything in view; the grid's cells and the axes are 1 m in a room, and tens and hundreds of metres in a valley.
  fit() {
    const seen = this.view.fit(this.places(), this.ahead());
    if (seen) {
      const metres = 10 ** Math.max(0, Math.ceil(Math.log10(this.view.around.distance / 50)));
      for (const o of [this.grid, this.axes]) o.scale.setScalar(metres);
    }
    return seen;
  }

  // Where the first camera of the scene looks.
  ahead() {
    for (const layer of this.layers.values())
      for (const { item } of layer.group.visible ? layer.parts : [])
        if (item.kind === "frusta" && item.count) {
          const at = (k) => new Vector3().fromArray(item.corner, 3 * k).applyMatrix4(layer.group.matrix);
          return at(1).add(at(2)).add(at(3)).add(at(4)).divideScalar(4).sub(at(0));
        }
    return null;
  }

  *places() {
    for (const layer of this.layers.values()) if (layer.group.visible) yield* layer.places();
  }

  click(x, y) {
    const hit = this.pointer.at(this.layers.values(), x, y);
    if (hit) this.followed = { layer: hit.layer, was: hit.layer.middle() };
    if (this.on.has("measure")) {
      const point = hit?.point ?? this.pointer.ground(x, y);
      if (point) this.measured = this.measured.length === 2 ? [point] : [...this.measured, point];
    }
    this.changed();
  }

  hover() {
    if (this.hovering) return;
    this.hovering = requestAnimationFrame(() => {
      this.hovering = null;
      const hit = this.mouse && this.pointer.at(this.layers.values(), this.mouse[0], this.mouse[1]);
      this.pointed(hit ? describe(hit) : [], this.mouse?.[2], this.mouse?.[3]);
    });
  }

  render(pixels) {
    this.pixels = pixels;
    const { width, height } = this.canvas;
    this.view.size(width, height);
    this.look();
    const flying = this.view.step();
    const { camera } = this.view;
    this.lamp.position.copy(camera.position);
    this.lamp.target.position.copy(this.view.orbit.target);
    this.dress();
    const ctx = paint(this.scene, camera, this.canvas);
    ctx.setTransform(pixels, 0, 0, pixels, 0, 0);
    const [w, h] = [width / pixels, height / pixels];
    drawTexts(ctx, this.layers.values(), camera, w, h);
    drawScales(ctx, this.layers.values(), w, this.theme());
    if (this.measured.length) drawMeasure(ctx, this.measured, camera, w, h, this.theme());
    if (flying) this.changed();
  }

  dress() {
    const { bg, grid } = this.theme();
    if (this.dressed === bg + grid) return;
    this.dressed = bg + grid;
    this.scene.background = new Color(bg);
    this.grid.material.vertexColors = false;
    this.grid.material.color.set(grid);
    this.grid.material.needsUpdate = true;
  }

  // For tests and for those who automate the page: where a place of the fixed frame is seen on the canvas.
  seen(x, y, z) {
    this.view.camera.updateMatrixWorld();
    return project(new Vector3(x, y, z), this.view.camera, this.canvas.clientWidth, this.canvas.clientHeight);
  }

  memory = memory;

  close() {
    if (this.hovering) cancelAnimationFrame(this.hovering);
    for (const key of [...this.layers.keys()]) this.remove(key);
    for (const o of [this.grid, this.axes]) {
      o.geometry.dispose();
      o.material.dispose();
    }
    this.view.close();
  }
}
