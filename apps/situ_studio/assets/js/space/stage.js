// The scene of a 3D panel: its layers, the viewer, and the tools.

import { Color, Frustum, Matrix4, Scene, Vector3 } from "three";
import { paintScene, memoryUsage } from "./renderer.js";
import { Ground } from "./ground.js";
import { Layer } from "./layer.js";
import { FrameTree } from "./frames.js";
import { Viewpoint } from "./viewpoint.js";
import { Pointer } from "./pointer.js";
import { drawMeasure, drawScales, drawTexts, projectPoint } from "./overlay.js";
import { countPoints, describeHit, isThinned } from "./descriptions.js";

// Returns the key of the layer with the visible points of a cloud that is only partly drawn.
const nearKey = (key) => `${key} near`;

export const openStage = (canvas, options) => new Stage(canvas, options);

class Stage {
  // changed(): redraw; pointed(lines, x, y): text for the item under the mouse; theme(): the page's colors
  constructor(canvas, { changed, pointed, theme }) {
    this.canvas = canvas;
    this.changed = changed;
    this.pointed = pointed;
    this.theme = theme;
    this.scene = new Scene();
    this.view = new Viewpoint(canvas, changed);
    this.pointer = new Pointer(canvas, this.view);
    this.layers = new Map();
    this.trees = new Map();
    this.on = new Set();
    this.measured = [];
    this.pixels = devicePixelRatio;
    this.ground = new Ground(this.scene);
    this.addListeners();
    if (!canvas.getContext("2d")) throw new Error("this browser does not support canvases");
  }

  addListeners() {
    const listenTo = (name, f) => this.canvas.addEventListener(name, f);
    /** @type {[number, number] | null} */
    let down = null;
    listenTo("pointermove", (e) => {
      this.mouse = e.buttons ? null : [e.offsetX, e.offsetY, e.clientX, e.clientY];
      this.handleHover();
    });
    listenTo("pointerleave", () => {
      this.mouse = null;
      this.pointed([]);
    });
    listenTo("pointerdown", (e) => (down = [e.offsetX, e.offsetY]));
    listenTo("pointerup", (e) => {
      if (down && Math.hypot(e.offsetX - down[0], e.offsetY - down[1]) < 4) this.handleClick(e.offsetX, e.offsetY);
      down = null;
    });
    listenTo("dblclick", () => this.useTool("fit"));
  }

  // Sets the message and properties of a layer. Layers with frame trees place the others.
  putLayer(key, content) {
    const layer = this.layers.get(key) ?? this.openLayer(key);
    layer.group.visible = content.props.visible !== false;
    const frame = content.frame;
    if (frame?.value?.frames) this.trees.set(key, { frames: frame.value.frames, props: content.props });
    else this.trees.delete(key);
    const looks = JSON.stringify([content.props, content.name, this.trees.has(key)]);
    if (content.changed || looks !== layer.looks) {
      layer.looks = looks;
      layer.content = content;
      if (!this.trees.has(key)) layer.fill(content, this.pixels);
    }
    this.arrangeLayers();
  }

  openLayer(key) {
    const layer = new Layer(this.changed);
    this.layers.set(key, layer);
    this.scene.add(layer.group);
    return layer;
  }

  // Returns the planes of the view in a layer's own frame if its clouds are only partly drawn, else null.
  viewPlanes(key) {
    const layer = this.layers.get(key);
    if (!layer?.group.visible || !layer.parts.some(isThinned)) return null;
    const { camera } = this.view;
    camera.updateMatrixWorld();
    const all = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
    const { planes } = new Frustum().setFromProjectionMatrix(all.multiply(layer.group.matrix));
    return planes.flatMap(({ normal, constant }) => [normal.x, normal.y, normal.z, constant]);
  }

  // Draws the visible points in addition to the layer's own points, or instead of them while nothing moves.
  refineLayer(key, frame) {
    const layer = this.layers.get(key);
    if (!frame) return this.removeLayer(nearKey(key));
    if (!layer) return;
    const scale = layer.parts.find((p) => p.scale)?.scale;
    const range = scale ? { range: "fixed", low: scale.span[0], high: scale.span[1] } : {};
    const props = { ...layer.content.props, ...range };
    this.putLayer(nearKey(key), { ...layer.content, props, frame, changed: true });
    this.layers.get(nearKey(key)).near = true;
    this.hideThinned(key, true);
  }

  hideThinned(key, on) {
    const drawn = this.layers.has(nearKey(key));
    for (const part of this.layers.get(key)?.parts ?? []) part.object.visible = !(on && drawn && isThinned(part));
  }

  removeLayer(key) {
    const layer = this.layers.get(key);
    this.trees.delete(key);
    if (this.layers.has(nearKey(key))) this.removeLayer(nearKey(key));
    if (!layer) return;
    layer.clear();
    this.scene.remove(layer.group);
    this.layers.delete(key);
    if (this.followed?.layer === layer) this.followed = null;
    this.arrangeLayers();
  }

  // Places every layer in the fixed frame, and updates the followed one.
  arrangeLayers() {
    const [first] = this.trees.values();
    const tree = new FrameTree(first?.frames, first?.props.fixed);
    for (const [key, layer] of this.layers) {
      if (this.trees.has(key)) {
        const { props } = this.trees.get(key);
        const items = tree.axesScene(props.axis ?? 0.3);
        layer.fill({ ...layer.content, frame: { items } }, this.pixels);
        continue;
      }
      const { matrix, problem } = tree.resolveFrame(layer.props?.frame);
      layer.unplaced = problem ?? null;
      layer.group.visible = layer.props?.visible !== false && !problem;
      layer.setMatrix(matrix);
    }
    this.followLayer();
    this.changed();
  }

  followLayer() {
    const f = this.followed;
    const now = f && this.on.has("follow") && f.layer.centerPoint();
    if (!now) return;
    if (f.was) this.view.moveBy(now.clone().sub(f.was));
    f.was = now;
  }

  layerProblem(key) {
    return this.layers.get(key)?.problem ?? null;
  }

  // Describes how many points are drawn; empty if there are no clouds.
  describeCounts() {
    const parts = [...this.layers.values()].flatMap((l) => (l.group.visible && !l.near ? l.parts : []));
    const [shown, all] = countPoints(parts);
    if (!all) return "";
    const [close, here] = countPoints(
      [...this.layers.values()].flatMap((l) => (l.group.visible && l.near ? l.parts : [])),
    );
    const formatCount = (n) => n.toLocaleString("en-US");
    const seen = here
      ? `; seen from here ${close < here ? `${formatCount(close)} of ` : "all "}${formatCount(here)}`
      : "";
    return (
      (shown < all ? `${formatCount(shown)} of ${formatCount(all)} points` : `${formatCount(all)} points`) + seen
    );
  }

  // Uses a tool of the toolbar; returns the tools that are switched on.
  useTool(name) {
    if (name === "fit") this.fitView();
    else if (name === "top") this.view.lookFromTop();
    else if (this.on.has(name)) this.on.delete(name);
    else this.on.add(name);
    if (name === "fly") this.view.setFlying(this.on.has("fly"));
    if (name === "measure") this.measured = [];
    if (name === "follow" && this.followed) this.followed.was = this.followed.layer.centerPoint();
    if (name === "fly") this.canvas.focus();
    this.changed();
    return [...this.on];
  }

  // Fits the view to everything, again when more has arrived, until the viewer moves.
  fitNewLayers() {
    const filled = [...this.layers].filter(([, l]) => l.parts.length && !l.near).map(([key]) => key);
    const known = this.looked ?? new Set();
    if (filled.every((key) => known.has(key)) || (this.looked && this.view.moved)) return;
    if (this.fitView()) this.looked = new Set(filled);
  }

  // Fits everything in view. The grid's cells and the axes are 1 m in a room, and tens or hundreds of meters in a
  // valley.
  fitView() {
    const seen = this.view.fitPoints(this.samplePoints(), this.cameraDirection());
    if (seen) {
      const distance = this.view.around?.distance ?? 0;
      this.ground.setScale(10 ** Math.max(0, Math.ceil(Math.log10(distance / 50))));
    }
    return seen;
  }

  // Returns the viewing direction of the scene's first camera, or null.
  cameraDirection() {
    for (const layer of this.layers.values())
      for (const { item } of layer.group.visible ? layer.parts : [])
        if (item.kind === "frusta" && item.count) {
          const cornerAt = (k) => new Vector3().fromArray(item.corner, 3 * k).applyMatrix4(layer.group.matrix);
          return cornerAt(1).add(cornerAt(2)).add(cornerAt(3)).add(cornerAt(4)).divideScalar(4).sub(cornerAt(0));
        }
    return null;
  }

  *samplePoints() {
    for (const layer of this.layers.values()) if (layer.group.visible) yield* layer.samplePoints();
  }

  handleClick(x, y) {
    const hit = this.pointer.hitAt(this.layers.values(), x, y);
    if (hit) this.followed = { layer: hit.layer, was: hit.layer.centerPoint() };
    if (this.on.has("measure")) {
      const point = hit?.point ?? this.pointer.groundAt(x, y);
      if (point) this.measured = this.measured.length === 2 ? [point] : [...this.measured, point];
    }
    this.changed();
  }

  handleHover() {
    if (this.hovering) return;
    this.hovering = requestAnimationFrame(() => {
      this.hovering = null;
      const hit = this.mouse && this.pointer.hitAt(this.layers.values(), this.mouse[0], this.mouse[1]);
      this.pointed(hit ? describeHit(hit) : [], this.mouse?.[2], this.mouse?.[3]);
    });
  }

  render(pixels) {
    this.pixels = pixels;
    const { width, height } = this.canvas;
    this.view.setAspect(width, height);
    this.fitNewLayers();
    const flying = this.view.flyStep();
    const { camera } = this.view;
    this.ground.placeLamp(camera.position, this.view.orbit.target);
    this.applyTheme();
    const ctx = paintScene(this.scene, camera, this.canvas);
    ctx.setTransform(pixels, 0, 0, pixels, 0, 0);
    const [w, h] = [width / pixels, height / pixels];
    drawTexts(ctx, this.layers.values(), camera, w, h);
    drawScales(ctx, this.layers.values(), w, this.theme());
    if (this.measured.length) drawMeasure(ctx, this.measured, camera, w, h, this.theme());
    if (flying) this.changed();
  }

  applyTheme() {
    const { bg, grid } = this.theme();
    if (this.dressed === bg + grid) return;
    this.dressed = bg + grid;
    this.scene.background = new Color(bg);
    this.ground.setColor(grid);
  }

  // Returns the canvas position of a point of the fixed frame, for tests and automation.
  projectPosition(x, y, z) {
    this.view.camera.updateMatrixWorld();
    return projectPoint(new Vector3(x, y, z), this.view.camera, this.canvas.clientWidth, this.canvas.clientHeight);
  }

  memory = memoryUsage;

  close() {
    if (this.hovering) cancelAnimationFrame(this.hovering);
    for (const key of [...this.layers.keys()]) this.removeLayer(key);
    this.ground.dispose();
    this.view.close();
  }
}
