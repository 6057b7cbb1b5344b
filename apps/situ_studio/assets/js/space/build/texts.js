// Builds texts as small signs that face the viewer, for headsets, which have no canvas over the image.

import { CanvasTexture, Group, LinearFilter, Sprite, SpriteMaterial, SRGBColorSpace } from "three";
import { FONT_FACE, readableColor } from "../../page/theme.js";
import { getContext2d } from "../../page/dom.js";

// The height of a line in meters and in pixels, and the maximum number of signs.
const HEIGHT = 0.06;
const PIXELS = 64;
const MOST = 200;

export function buildTexts(item, props) {
  const group = new Group();
  for (let i = 0; i < Math.min(item.count, MOST); i++) {
    const { texture, aspect } = signTexture(item.names[i], props.color);
    const sprite = new Sprite(new SpriteMaterial({ map: texture }));
    sprite.position.fromArray(item.position, 3 * i);
    sprite.position.z += HEIGHT;
    sprite.scale.set(HEIGHT * aspect, HEIGHT, 1);
    group.add(sprite);
  }
  return { object: group, name: (i) => item.names[i] };
}

// Returns a texture with a text on a transparent background, with the given aspect ratio.
export function textTexture(text, color, aspect) {
  const canvas = document.createElement("canvas");
  const ctx = getContext2d(canvas);
  canvas.height = 2 * PIXELS;
  canvas.width = Math.max(1, Math.min(Math.round(canvas.height * aspect), 4096));
  const setFont = (size) => (ctx.font = `${size}px ${FONT_FACE}`);
  setFont(canvas.height * 0.8);
  const room = canvas.width / Math.max(ctx.measureText(text).width, 1);
  if (room < 1) setFont(canvas.height * 0.8 * room);
  ctx.textBaseline = "middle";
  ctx.textAlign = "center";
  ctx.fillStyle = color;
  ctx.fillText(text, canvas.width / 2, canvas.height / 2);
  return { texture: canvasTexture(canvas), aspect };
}

function canvasTexture(canvas) {
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  texture.minFilter = LinearFilter;
  texture.generateMipmaps = false;
  return texture;
}

function signTexture(text, color) {
  const canvas = document.createElement("canvas");
  const ctx = getContext2d(canvas);
  const font = `${PIXELS * 0.6}px ${FONT_FACE}`;
  ctx.font = font;
  canvas.width = Math.min(Math.ceil(ctx.measureText(text).width + PIXELS * 0.5), 2048);
  canvas.height = PIXELS;
  ctx.font = font;
  ctx.textBaseline = "middle";
  ctx.fillStyle = color;
  ctx.fillRect(0, 0, canvas.width, PIXELS);
  ctx.fillStyle = readableColor(color);
  ctx.fillText(text, PIXELS * 0.25, PIXELS / 2);
  return { texture: canvasTexture(canvas), aspect: canvas.width / PIXELS };
}
