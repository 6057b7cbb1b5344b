// Builds solid items: lines and arrows, graphs with their nodes, boxes, voxels. All instances of a kind are one draw
// call.

import {
  BoxGeometry,
  BufferAttribute,
  BufferGeometry,
  Color,
  ConeGeometry,
  CylinderGeometry,
  EdgesGeometry,
  Group,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  MeshLambertMaterial,
  Quaternion,
  SphereGeometry,
  SRGBColorSpace,
  Vector3,
} from "three";
import { colorMode, rampColor, colorSpan } from "../colors.js";

// Above this number, lines are drawn thin.
const PIPES = 5000;
const UP = new Vector3(0, 1, 0);

function lambertMaterial(color, props, faint = 1) {
  const opacity = ((props.opacity ?? 100) / 100) * faint;
  return new MeshLambertMaterial({ color, opacity, transparent: opacity < 1, depthWrite: opacity >= 1 });
}

// `place(i, matrix)` sets the matrix of the i-th instance; `color(i)` may return its color.
function instancedMesh(geometry, material, count, place, color) {
  const mesh = new InstancedMesh(geometry, material, count);
  const matrix = new Matrix4();
  for (let i = 0; i < count; i++) {
    place(i, matrix);
    mesh.setMatrixAt(i, matrix);
    if (color) mesh.setColorAt(i, color(i));
  }
  mesh.frustumCulled = false;
  return mesh;
}

// Aligns an instance along the line from a to b; the pipe of an arrow ends at its head.
function alignPipe(a, b, radius, matrix, from = 0, to = 1) {
  const way = new Vector3().subVectors(b, a);
  const length = way.length();
  const turn = new Quaternion().setFromUnitVectors(UP, length > 0 ? way.clone().divideScalar(length) : UP);
  const middle = new Vector3().lerpVectors(a, b, (from + to) / 2);
  matrix.compose(middle, turn, new Vector3(radius, Math.max(length * (to - from), 1e-9), radius));
}

const vectorAt = (array, i) => new Vector3(array[3 * i], array[3 * i + 1], array[3 * i + 2]);

export function buildLines(item, props) {
  const { position, color, count } = item;
  const nameAt = (i) => item.names?.[i] ?? item.name ?? "line";
  if (count > PIPES && !item.arrow) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(position, 3));
    return {
      object: new LineSegments(geometry, new LineBasicMaterial({ color: props.color })),
      name: (i) => nameAt(i >> 1),
    };
  }
  const radius = (props.thickness ?? 15) / 2000;
  const own =
    color &&
    ((i) => new Color().setRGB(color[3 * i] / 255, color[3 * i + 1] / 255, color[3 * i + 2] / 255, SRGBColorSpace));
  const tint = own ? "#ffffff" : props.color;
  const pipeEnds = (i) => [vectorAt(position, 2 * i), vectorAt(position, 2 * i + 1)];
  const headStart = (a, b) => (item.arrow ? Math.max(0, 1 - (radius * 8) / Math.max(a.distanceTo(b), 1e-9)) : 1);
  const group = new Group();
  group.add(
    instancedMesh(
      new CylinderGeometry(1, 1, 1, 8),
      lambertMaterial(tint, props),
      count,
      (i, m) => {
        const [a, b] = pipeEnds(i);
        alignPipe(a, b, radius, m, 0, headStart(a, b));
      },
      own,
    ),
  );
  if (item.arrow)
    group.add(
      instancedMesh(
        new ConeGeometry(2.4, 1, 10),
        lambertMaterial(tint, props),
        count,
        (i, m) => {
          const [a, b] = pipeEnds(i);
          alignPipe(a, b, radius, m, headStart(a, b), 1);
        },
        own,
      ),
    );
  return { object: group, name: nameAt };
}

export function buildGraphs(item, props) {
  const { position, edge, count, confidence } = item;
  const group = new Group();
  const radius = (props.thickness ?? 15) / 1000;
  const base = new Color(props.color),
    dim = new Color("#808080");
  // Joints with low confidence are gray.
  const sure = confidence && ((i) => base.clone().lerp(dim, 1 - confidence[i] / 255));
  const nodes = instancedMesh(
    new SphereGeometry(1, 14, 10),
    lambertMaterial(sure ? "#ffffff" : props.color, props),
    count,
    (i, m) => {
      if (item.bad?.has(i) || confidence?.[i] === 0) m.makeScale(0, 0, 0);
      else m.makeScale(radius, radius, radius).setPosition(vectorAt(position, i));
    },
    sure,
  );
  group.add(nodes);
  const edges = edge.length / 2;
  if (edges) {
    // nothing is drawn for joints with zero confidence
    const isKnown = (i) => confidence?.[edge[2 * i]] !== 0 && confidence?.[edge[2 * i + 1]] !== 0;
    const placeInstance = (i, m) =>
      isKnown(i)
        ? alignPipe(vectorAt(position, edge[2 * i]), vectorAt(position, edge[2 * i + 1]), radius * 0.6, m)
        : m.makeScale(0, 0, 0);
    group.add(
      instancedMesh(new CylinderGeometry(1, 1, 1, 8), lambertMaterial(props.color, props), edges, placeInstance),
    );
  }
  const nameAt = (i, object) => (object === nodes ? (item.names?.[i] ?? "node") : `between ${edgeEnds(item, i)}`);
  return { object: group, name: nameAt };
}

const edgeEnds = (item, i) => [item.edge[2 * i], item.edge[2 * i + 1]].map((n) => item.names?.[n] ?? n).join(" and ");

export function buildBoxes(item, props) {
  const { matrix, count } = item;
  const placeInstance = (i, m) => m.fromArray(matrix, 16 * i);
  const group = new Group();
  const cube = new BoxGeometry(1, 1, 1);
  group.add(instancedMesh(cube, lambertMaterial(props.color, props, 0.22), count, placeInstance));
  const corners = new EdgesGeometry(cube).attributes.position;
  const ends = new Float32Array(count * corners.count * 3);
  const m = new Matrix4(),
    v = new Vector3();
  for (let i = 0; i < count; i++) {
    placeInstance(i, m);
    for (let k = 0; k < corners.count; k++)
      v.fromBufferAttribute(corners, k)
        .applyMatrix4(m)
        .toArray(ends, 3 * (i * corners.count + k));
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(ends, 3));
  group.add(new LineSegments(geometry, new LineBasicMaterial({ color: props.color })));
  const nameAt = (i, object) => item.names?.[object.isInstancedMesh ? i : Math.floor(i / corners.count)] ?? "box";
  return { object: group, name: nameAt };
}

export function buildVoxels(item, props) {
  const { position, count, size } = item;
  const mode = colorMode(item, props);
  const span = mode === "one" ? null : colorSpan(item, mode, props);
  const axis = { x: 0, y: 1, z: 2 }[mode];
  const valueAt = (i) => {
    if (mode === "value") return item.value[i];
    return mode === "distance" ? vectorAt(position, i).length() : position[3 * i + axis];
  };
  const color = span && ((i) => rampColor(valueAt(i), span));
  const placeInstance = (i, m) => m.makeScale(size, size, size).setPosition(vectorAt(position, i));
  const object = instancedMesh(
    new BoxGeometry(0.96, 0.96, 0.96),
    lambertMaterial(color ? "#ffffff" : props.color, props),
    count,
    placeInstance,
    color,
  );
  const nameAt = (i) => `${item.name ?? "voxel"}${item.value ? ` = ${item.value[i]}` : ""}`;
  return { object, scale: span ? { span, mode } : null, name: nameAt };
}
