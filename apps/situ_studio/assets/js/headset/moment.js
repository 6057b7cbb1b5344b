// One moment of a headset as bytes (docs: `Situ.Studio.Headset.Packet`).
import { now } from "../sensor/clock.js";

const HEAD = 16;
const JOINTS = 25;
const POSE = 7;
const FLAGS = { left: 1, right: 2, gaze: 4, planes: 8, "left selects": 16, "right selects": 32, selected: 64 };

const numbers = ({ position: p, orientation: o }) => [p.x, p.y, p.z, o.x, o.y, o.z, o.w];

export class Moments {
  constructor(session, space) {
    Object.assign(this, { session, space, pressed: { left: false, right: false }, selected: true, seen: new Map() });
    for (const name of ["selectstart", "selectend"])
      session.addEventListener(name, ({ inputSource: { handedness } }) => {
        if (!(handedness in this.pressed)) return;
        this.pressed[handedness] = name === "selectstart";
        this.selected = true;
      });
  }

  // Null while the headset does not know where it is.
  take(time, frame) {
    const head = frame.getViewerPose(this.space);
    if (!head) return null;
    let flags = 0;
    const rows = [numbers(head.transform)];
    for (const side of ["left", "right"]) {
      const joints = this.hand(frame, side);
      if (joints) {
        flags |= FLAGS[side];
        rows.push(joints);
      }
      if (this.pressed[side]) flags |= FLAGS[`${side} selects`];
    }
    const gaze = this.gaze(frame);
    if (gaze) {
      flags |= FLAGS.gaze;
      rows.push(numbers(gaze.transform));
    }
    const planes = this.planes(frame);
    if (planes) flags |= FLAGS.planes;
    if (this.selected) flags |= FLAGS.selected;
    this.selected = false;
    return pack(flags, moment(time), rows, planes);
  }

  hand(frame, side) {
    const source = [...this.session.inputSources].find((s) => s.hand && s.handedness === side);
    if (!source) return null;
    const joints = [];
    for (const joint of source.hand.values()) {
      const pose = frame.getJointPose(joint, this.space);
      if (!pose) return null;
      joints.push(...numbers(pose.transform));
    }
    return joints.length === JOINTS * POSE ? joints : null;
  }

  gaze(frame) {
    const source = [...this.session.inputSources].find((s) => s.targetRayMode === "gaze");
    return source ? frame.getPose(source.targetRaySpace, this.space) : null;
  }

  // All planes when one has come, gone or changed; else null.
  planes(frame) {
    const found = frame.detectedPlanes;
    if (!found) return null;
    const same = found.size === this.seen.size && [...found].every((p) => this.seen.get(p) === p.lastChangedTime);
    if (same) return null;
    const rows = [];
    this.seen = new Map();
    for (const plane of found) {
      const pose = frame.getPose(plane.planeSpace, this.space);
      if (!pose) continue;
      this.seen.set(plane, plane.lastChangedTime);
      const polygon = [...plane.polygon].map((p) => [p.x, p.z]);
      rows.push({ label: plane.semanticLabel ?? "", pose: numbers(pose.transform), polygon });
    }
    return rows;
  }
}

// A frame's own time, where it is of this page's clock.
function moment(time) {
  const own = performance.timeOrigin + time;
  const here = now();
  return Math.abs(own - here) < 1000 ? own : here;
}

function pack(flags, ms, rows, planes) {
  const floats = rows.flat();
  const text = planes ? new TextEncoder().encode(JSON.stringify(planes)) : new Uint8Array(0);
  const bytes = new Uint8Array(HEAD + 4 * floats.length + text.length);
  const view = new DataView(bytes.buffer);
  view.setUint8(0, 4);
  view.setUint8(1, flags);
  view.setFloat64(8, ms, true);
  floats.forEach((value, i) => view.setFloat32(HEAD + 4 * i, value, true));
  bytes.set(text, HEAD + 4 * floats.length);
  return bytes;
}
