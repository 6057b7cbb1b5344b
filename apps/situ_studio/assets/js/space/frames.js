// The frame tree of a panel: returns the matrix from each frame to the fixed one.

import { Matrix4 } from "three";

export class FrameTree {
  constructor(frames = {}, fixed = "") {
    this.frames = frames;
    this.fixed = fixed || Object.values(frames)[0]?.root || "";
  }

  // Returns {matrix} or {problem}. Items without a frame are in the fixed one.
  resolveFrame(name) {
    if (!name || name === this.fixed) return { matrix: null };
    const from = this.frames[name];
    if (!from) return { problem: `there is no frame "${name}" at this time` };
    if (!this.frames[this.fixed]) return { problem: `there is no fixed frame "${this.fixed}" at this time` };
    const fixed = this.frames[this.fixed];
    if (from.problem ?? fixed.problem) return { problem: from.problem ?? fixed.problem };
    if (from.root !== fixed.root)
      return {
        problem: `"${name}" is not connected to "${this.fixed}": their roots are "${from.root}" and "${fixed.root}"`,
      };
    const matrix = new Matrix4().fromArray(fixed.matrix).invert();
    return { matrix: matrix.multiply(new Matrix4().fromArray(from.matrix)) };
  }

  // Returns the axes of every resolvable frame as items of arrows and texts.
  axesScene(length) {
    const position = [],
      color = [],
      names = [],
      texts = [],
      labels = [];
    for (const name of Object.keys(this.frames).sort()) {
      const { matrix, problem } = this.resolveFrame(name);
      if (problem) continue;
      const e = (matrix ?? new Matrix4()).elements;
      [0, 1, 2].forEach((k) => {
        position.push(e[12], e[13], e[14]);
        position.push(...[0, 1, 2].map((r) => e[12 + r] + e[4 * k + r] * length));
        color.push(...[0, 1, 2].map((r) => (r === k ? 224 : 70)));
        names.push(`${name} ${"xyz"[k]}`);
      });
      texts.push(e[12], e[13], e[14]);
      labels.push(name);
    }
    return [
      {
        kind: "lines",
        arrow: true,
        count: names.length,
        position: Float32Array.from(position),
        color: Uint8Array.from(color),
        names,
      },
      { kind: "texts", count: labels.length, position: Float32Array.from(texts), names: labels },
    ];
  }
}
