// Texts as small signs that face the viewer, for where no canvas lies over the picture.

import { CanvasTexture, Group, LinearFilter, Sprite, SpriteMaterial, SRGBColorSpace } from "three";
import { FONT_FACE, ink } from "../../page/theme.js";

// Metres for a line of text, and pixels for it; more than so many signs are not drawn.
const HEIGHT = 0.06;
const PIXELS = 64;
const MOST = 200;

export function texts(item, props) {
  const group = new Group();
  for (let i = 0; i < Math.min(item.count, MOST); i++) {
    const { texture, aspect } = sign(item.names[i], props.color);
    const sprite = new Sprite(new SpriteMaterial({ map: texture }));
    sprite.position.fromArray(item.position, 3 * i);
    sprite.position.z += HEIGHT;
    sprite.scale.set(HEIGHT * aspect, HEIGHT, 1);
    group.add(sprite);
  }
  return { object: group, name: (i) => item.names[i] };
}

// A text in a colour on nothing, as wide as it is asked to be for its height.
export function written(text, color, aspect) {
  const canvas = document.createElement("canvas");
  const ctx = canvas.getContext("2d");
  canvas.height = 2 * PIXELS;
  canvas.width = Math.max(1, Math.min(Math.round(canvas.height * aspect), 4096));
  const font = (size) => (ctx.font = `${size}px ${FONT_FACE}`);
  font(canvas.height * 0.8);
  const room = canvas.width / Math.max(ctx.measureText(text).width, 1);
  if (room < 1) font(canvas.height * 0.8 * room);
  Object.assign(ctx, { textBaseline: "middle", textAlign: "center", fillStyle: color });
  ctx.fillText(text, canvas.width / 2, canvas.height / 2);
  return { texture: textureOf(canvas), aspect };
}

function textureOf(canvas) {
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  texture.minFilter = LinearFilter;
  texture.generateMipmaps = false;
  return texture;
}

function sign(text, color) {
  const canvas = document.createElement("canvas");
  const ctx = canvas.getContext("2d");
  const font = `${PIXELS * 0.6}px ${FONT_FACE}`;
  ctx.font = font;
  canvas.width = Math.min(Math.ceil(ctx.measureText(text).width + PIXELS * 0.5), 2048);
  canvas.height = PIXELS;
  ctx.font = font;
  ctx.textBaseline = "middle";
  ctx.fillStyle = color;
  ctx.fillRect(0, 0, canvas.width, PIXELS);
  ctx.fillStyle = ink(color);
  ctx.fillText(text, PIXELS * 0.25, PIXELS / 2);
  return { texture: textureOf(canvas), aspect: canvas.width / PIXELS };
}
