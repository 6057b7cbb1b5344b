// Shares one WebGL context among all panels of the page, since browsers limit their number. Each panel's image is
// copied onto its canvas.

import { WebGLRenderer } from "three";

/** @type {WebGLRenderer | null} */
let shared = null;

// Draws a scene onto a canvas of the page, at the canvas's own size.
export function paintScene(scene, camera, canvas) {
  const gl = (shared ??= createRenderer());
  const { width, height } = canvas;
  const { domElement: from } = gl;
  if (from.width < width || from.height < height)
    gl.setSize(Math.max(from.width, width), Math.max(from.height, height), false);
  gl.setViewport(0, 0, width, height);
  gl.setScissor(0, 0, width, height);
  gl.render(scene, camera);
  const ctx = canvas.getContext("2d");
  ctx.setTransform(1, 0, 0, 1, 0, 0);
  ctx.drawImage(from, 0, from.height - height, width, height, 0, 0, width, height);
  return ctx;
}

function createRenderer() {
  let gl;
  try {
    gl = new WebGLRenderer({ antialias: true, powerPreference: "high-performance" });
  } catch {
    throw new Error("this browser cannot draw in 3D: WebGL is disabled or missing");
  }
  gl.setPixelRatio(1);
  gl.setScissorTest(true);
  gl.setSize(16, 16, false);
  return gl;
}

// Returns the number of geometries and textures in the context, for tests.
export const memoryUsage = () => (shared ? { ...shared.info.memory } : { geometries: 0, textures: 0 });
