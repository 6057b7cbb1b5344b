// Builds surfaces: meshes, rectangles with or without an image, and camera frusta.

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  Group,
  LineBasicMaterial,
  LineLoop,
  LineSegments,
  LinearFilter,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  SRGBColorSpace,
  Texture,
} from "three";
import { textTexture } from "./texts.js";
import { createBitmap } from "../../visualizers/pixels.js";
import { depthStyle } from "../../visualizers/depth_colors.js";

// A mesh that is sent once and reused keeps its normals.
const normals = new WeakMap();

export function buildMeshes(item, props) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(item.position, 3));
  geometry.setIndex(new BufferAttribute(item.index, 1));
  const known = normals.get(item.position);
  if (known) geometry.setAttribute("normal", new BufferAttribute(known, 3));
  else {
    geometry.computeVertexNormals();
    normals.set(item.position, geometry.getAttribute("normal").array);
  }
  const opacity = (props.opacity ?? 100) / 100;
  const material = new MeshLambertMaterial({
    color: props.color,
    side: DoubleSide,
    opacity,
    transparent: opacity < 1,
  });
  const object = new Mesh(geometry, material);
  if (item.matrix) object.applyMatrix4(new Matrix4().fromArray(item.matrix));
  object.frustumCulled = false;
  return { object, name: () => item.name ?? "mesh" };
}

// Places an image's plane 1 m in front of its camera, or at the distance of the properties.
function scaleFromApex(corners, apex, distance) {
  if (!apex) return corners;
  return corners.map((v, i) => apex[i % 3] + (v - apex[i % 3]) * distance);
}

export function buildQuads(item, props, _pixels, changed) {
  const group = new Group();
  const rows = [];
  for (let i = 0; i < item.count; i++)
    rows.push(
      Float32Array.from(
        scaleFromApex(Array.from(item.corner.slice(12 * i, 12 * i + 12)), item.apex, props.plane ?? 1),
      ),
    );
  const opacity = ((props.opacity ?? 100) / 100) * (item.apex ? 0.75 : 1);
  const basic = { side: DoubleSide, opacity, transparent: opacity < 1, depthWrite: opacity >= 1 };
  const material = new MeshBasicMaterial({ ...basic, color: item.picture ? "#ffffff" : props.color });
  if (item.picture) {
    material.visible = false;
    showImage(item, material, props, changed);
  } else if (item.text) {
    const { texture } = textTexture(item.text, props.color, aspectRatio(rows[0]));
    Object.assign(material, { map: texture, transparent: true });
    material.color.set("#ffffff");
  }
  for (const corners of rows) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(corners, 3));
    geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
    geometry.setIndex([0, 3, 1, 1, 3, 2]);
    group.add(new Mesh(geometry, material));
    const border = new BufferGeometry();
    border.setAttribute("position", new BufferAttribute(corners, 3));
    if (item.text) continue;
    group.add(new LineLoop(border, new LineBasicMaterial({ color: item.picture ? "#c8ccd2" : props.color })));
  }
  return { object: group, name: (i) => item.names?.[i] ?? item.names?.[0] ?? "surface" };
}

// Returns the aspect ratio of a surface.
function aspectRatio([ax, ay, az, bx, by, bz, cx, cy, cz]) {
  const high = Math.hypot(cx - bx, cy - by, cz - bz);
  return high > 0 ? Math.hypot(bx - ax, by - ay, bz - az) / high : 1;
}

async function showImage(item, material, props, changed) {
  const { pixels, width, height, unit } = item.picture;
  try {
    const { image } = await createBitmap(
      { pixels, width, height, unit, data: item.bytes },
      pixels === 5 ? depthStyle({ ...props, range: props.depth_range }) : null,
    );
    const upright = await createImageBitmap(image, { imageOrientation: "flipY" });
    image.close();
    if (material.gone) return upright.close();
    const texture = new Texture(upright);
    texture.flipY = false;
    texture.colorSpace = SRGBColorSpace;
    texture.minFilter = LinearFilter;
    texture.generateMipmaps = false;
    texture.needsUpdate = true;
    Object.assign(material, { map: texture, visible: true, needsUpdate: true });
  } catch (error) {
    item.problem = `its image cannot be shown: ${error.message}`;
  }
  changed();
}

const EDGES = [0, 1, 0, 2, 0, 3, 0, 4, 1, 2, 2, 3, 3, 4, 4, 1];

export function buildFrusta(item, props) {
  const ends = new Float32Array(item.count * EDGES.length * 3);
  for (let i = 0; i < item.count; i++) {
    const row = Array.from(item.corner.slice(15 * i, 15 * i + 15));
    const corners = scaleFromApex(row, row.slice(0, 3), props.plane ?? 1);
    EDGES.forEach((from, k) => ends.set(corners.slice(3 * from, 3 * from + 3), 3 * (i * EDGES.length + k)));
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(ends, 3));
  const color = props.owned ? props.color : "#8a929c";
  const object = new LineSegments(geometry, new LineBasicMaterial({ color }));
  return { object, name: (i) => item.names?.[Math.floor(i / EDGES.length)] ?? "camera" };
}
