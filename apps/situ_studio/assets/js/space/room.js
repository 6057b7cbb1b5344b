// Shows the layers of a 3D panel in a headset's session.

import { DirectionalLight, Group, HemisphereLight, Matrix4, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { DRAWING_BYTES, readDrawing } from "../data/frames.js";
import { decodeScene } from "../data/scene.js";
import { Layer } from "./layer.js";

// Headsets have y up and look along -z; here z is up and x is ahead.
const AXES = new Matrix4().set(0, 0, -1, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1);
const PIXELS = 2;

export async function openRoom(session, { frame, problem }) {
  const gl = new WebGLRenderer({ antialias: true, alpha: true });
  gl.xr.enabled = true;
  gl.xr.setReferenceSpaceType("local-floor");
  await gl.xr.setSession(session);
  return new Room(gl, frame, problem);
}

export class Room {
  constructor(gl, frame, problem) {
    this.gl = gl;
    this.problem = problem;
    this.layers = new Map();
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(70, 1, 0.02, 200);
    this.rig = new Group();
    this.rig.applyMatrix4(AXES);
    this.rig.add(this.camera);
    const lamp = new DirectionalLight(0xffffff, 1.6);
    lamp.position.set(-1, 1, 3);
    this.scene.add(this.rig, lamp, new HemisphereLight(0xffffff, 0x8a8a92, 1.5));
    gl.setAnimationLoop((time, xr) => {
      if (xr) frame(time, xr);
      gl.render(this.scene, this.camera);
    });
  }

  // Shows a drawing, replacing the layer of the same name; returns the name.
  putLayer(bytes) {
    const { bytes: size } = readDrawing(new DataView(bytes), 0);
    const drawing = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, DRAWING_BYTES, size)));
    const at = DRAWING_BYTES + ((size + 7) & ~7);
    const frame = decodeScene(bytes, at, bytes.byteLength - at);
    const layer = this.layers.get(drawing.layer) ?? this.openLayer(drawing.layer);
    const props = { ...drawing.props, signs: true };
    layer.fill({ name: drawing.layer, short: drawing.layer, props, own: true, frame }, PIXELS);
    this.problem(frame.problems.length ? `${drawing.layer}: ${frame.problems[0]}` : "Running.");
    return drawing.layer;
  }

  openLayer(name) {
    const layer = new Layer(() => {});
    this.layers.set(name, layer);
    this.scene.add(layer.group);
    return layer;
  }

  close() {
    this.gl.setAnimationLoop(null);
    for (const layer of this.layers.values()) layer.clear();
    this.gl.dispose();
  }
}
