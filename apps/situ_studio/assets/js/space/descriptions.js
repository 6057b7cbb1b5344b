// Describes layers of a scene: how much of their clouds is drawn, and the item under the mouse.

import { Matrix4 } from "three";
import { formatNumber } from "../page/number_text.js";

export const isThinned = (part) => part.item.kind === "points" && (part.item.of ?? 0) > part.item.count;

// Returns the number of drawn points and of all points.
export function countPoints(parts) {
  const clouds = parts.filter((p) => p.item.kind === "points" && p.item.name !== "was here");
  const shown = clouds.reduce((n, p) => n + p.item.count, 0);
  return [shown, clouds.reduce((n, p) => n + Math.max(p.item.of ?? 0, p.item.count), 0)];
}

// Describes the object under the mouse: its stream, its name, its position in the stream's own frame.
export function describeHit({ layer, part, index, object, point }) {
  const own = point.clone().applyMatrix4(new Matrix4().copy(layer.group.matrix).invert());
  const place = [own.x, own.y, own.z].map((v) => formatNumber(v, 3)).join(", ");
  const value =
    part.item.value && part.item.kind === "points" ? [`value ${formatNumber(part.item.value[index], 4)}`] : [];
  return [layer.name, `${part.name(index, object)}`, `(${place}) m`, ...value];
}
