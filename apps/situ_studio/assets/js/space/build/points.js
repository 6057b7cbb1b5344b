// Builds points: a million are one draw call, colored on the graphics card.

import { BufferAttribute, BufferGeometry, Color, Points, ShaderMaterial, Vector4 } from "three";
import { MODES, colorMode, rampTexture, colorSpan } from "../colors.js";

const VERTEX = `
  attribute vec3 tone;
  attribute float value;
  uniform float size, metres, height, low, high;
  uniform int mode;
  uniform vec3 tint;
  uniform sampler2D ramp;
  varying vec3 shade;
  void main() {
    vec4 place = modelMatrix * vec4(position, 1.0);
    float v = mode == 2 ? place.x : mode == 3 ? place.y : mode == 4 ? place.z
      : mode == 5 ? length(place.xyz) : value;
    if (mode == 0) shade = pow(tone, vec3(2.2));
    else if (mode == 1) shade = tint;
    else shade = texture2D(ramp, vec2(clamp((v - low) / (high - low), 0.002, 0.998), 0.5)).rgb;
    gl_Position = projectionMatrix * viewMatrix * place;
    // the size in the world, scaled by distance
    float near = metres * projectionMatrix[1][1] * height / 2.0 / max(gl_Position.w, 1e-6);
    gl_PointSize = max(size, near);
  }`;

const FRAGMENT = `
  uniform float opacity, round_from;
  varying vec3 shade;
  void main() {
    vec2 d = gl_PointCoord - 0.5;
    if (round_from > 0.5 && dot(d, d) > 0.25) discard;
    gl_FragColor = vec4(shade, opacity);
    #include <colorspace_fragment>
  }`;

/** @type {import("three").DataTexture | null} */
let colors = null;
const SEEN = new Vector4();

export function buildPoints(item, props, pixels) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(item.position, 3));
  if (item.color) geometry.setAttribute("tone", new BufferAttribute(item.color, 3, true));
  if (item.value) geometry.setAttribute("value", new BufferAttribute(item.value, 1));
  const mode = colorMode(item, props);
  const span = mode === "own" || mode === "one" ? [0, 1] : colorSpan(item, mode, props);
  const size = (props.point_size ?? 2) * pixels;
  const opacity = (props.opacity ?? 100) / 100;
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    transparent: opacity < 1,
    uniforms: {
      size: { value: size },
      metres: { value: (props.point_mm ?? 0) / 1000 },
      height: { value: 1 },
      low: { value: span[0] },
      high: { value: span[1] },
      mode: { value: item.color || mode !== "own" ? MODES[mode] : MODES.one },
      tint: { value: new Color(props.color) },
      ramp: { value: (colors ??= rampTexture()) },
      opacity: { value: opacity },
      round_from: { value: size >= 4 || props.point_mm > 0 ? 1 : 0 },
    },
  });
  const object = new Points(geometry, material);
  object.frustumCulled = false;
  object.onBeforeRender = (renderer) => {
    material.uniforms.height.value = renderer.getCurrentViewport(SEEN).w;
    material.uniformsNeedUpdate = true;
  };
  const scale = mode === "own" || mode === "one" ? null : { span, mode };
  return { object, scale, name: () => item.name ?? "point" };
}
