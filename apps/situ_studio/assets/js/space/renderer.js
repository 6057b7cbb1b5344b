// One WebGL context for all panels of the page: browsers give out few. Each panel's picture is copied onto its canvas.

import { WebGLRenderer } from "three";

let shared = null;

// The picture of a scene on a canvas of the page, at the canvas's own size.
export function paint(scene, camera, canvas) {
  const gl = (shared ??= make());
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

function make() {
  let gl;
  try {
    gl = new WebGLRenderer({ antialias: true, powerPreference: "high-performance" });
  } catch {
    throw new Error("this browser draws nothing in 3D: WebGL is switched off or missing");
  }
  gl.setPixelRatio(1);
  gl.setScissorTest(true);
  gl.setSize(16, 16, false);
  return gl;
}

// The number of geometries and textures in the context, for tests.
export const memory = () => (shared ? { ...shared.info.memory } : { geometries: 0, textures: 0 });
