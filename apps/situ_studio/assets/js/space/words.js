// Layers of a scene in words: how much of their clouds is drawn, and what lies under the mouse.

import { Matrix4 } from "three";
import { number } from "../page/number_text.js";

export const thinned = (part) => part.item.kind === "points" && (part.item.of ?? 0) > part.item.count;

// How many points are drawn, and how many there are.
export function counted(parts) {
  const clouds = parts.filter((p) => p.item.kind === "points" && p.item.name !== "was here");
  const shown = clouds.reduce((n, p) => n + p.item.count, 0);
  return [shown, clouds.reduce((n, p) => n + Math.max(p.item.of ?? 0, p.item.count), 0)];
}

// The object under the mouse in words: its stream, its name, the place in the stream's own frame.
export function describe({ layer, part, index, object, point }) {
  const own = point.clone().applyMatrix4(new Matrix4().copy(layer.group.matrix).invert());
  const place = [own.x, own.y, own.z].map((v) => number(v, 3)).join(", ");
  const value = part.item.value && part.item.kind === "points" ? [`value ${number(part.item.value[index], 4)}`] : [];
  return [layer.name, `${part.name(index, object)}`, `(${place}) m`, ...value];
}
