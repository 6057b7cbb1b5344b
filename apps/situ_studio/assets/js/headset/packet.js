// Encodes the state of a headset as bytes (docs: `Situ.Studio.Headset.Packet`).
import { DEVICE, HEADSET_BYTES, HEADSET_FLAG as FLAG, writeHeadset } from "../data/frames.js";
import { now } from "../device/clock.js";

const JOINTS = 25;
const POSE = 7;

const poseNumbers = ({ position: p, orientation: o }) => [p.x, p.y, p.z, o.x, o.y, o.z, o.w];

export class PacketEncoder {
  constructor(session, space) {
    this.session = session;
    this.space = space;
    this.pressed = { left: false, right: false };
    this.selected = true;
    this.seen = new Map();
    for (const name of ["selectstart", "selectend"])
      session.addEventListener(name, ({ inputSource: { handedness } }) => {
        if (!(handedness in this.pressed)) return;
        this.pressed[handedness] = name === "selectstart";
        this.selected = true;
      });
  }

  // Returns the bytes of one frame, or null while the headset's pose is unknown.
  encodeFrame(time, frame) {
    const head = frame.getViewerPose(this.space);
    if (!head) return null;
    let flags = 0;
    const rows = [poseNumbers(head.transform)];
    for (const side of ["left", "right"]) {
      const joints = this.readHand(frame, side);
      if (joints) {
        flags |= FLAG[side];
        rows.push(joints);
      }
      if (this.pressed[side]) flags |= FLAG[`${side}_selects`];
    }
    const gaze = this.readGaze(frame);
    if (gaze) {
      flags |= FLAG.gaze;
      rows.push(poseNumbers(gaze.transform));
    }
    const planes = this.readPlanes(frame);
    if (planes) flags |= FLAG.planes;
    if (this.selected) flags |= FLAG.selected;
    this.selected = false;
    return packBytes(flags, frameTime(time), rows, planes);
  }

  readHand(frame, side) {
    const source = [...this.session.inputSources].find((s) => s.hand && s.handedness === side);
    if (!source) return null;
    const joints = [];
    for (const joint of source.hand.values()) {
      const pose = frame.getJointPose(joint, this.space);
      if (!pose) return null;
      joints.push(...poseNumbers(pose.transform));
    }
    return joints.length === JOINTS * POSE ? joints : null;
  }

  readGaze(frame) {
    const source = [...this.session.inputSources].find((s) => s.targetRayMode === "gaze");
    return source ? frame.getPose(source.targetRaySpace, this.space) : null;
  }

  // Returns all planes if one was added, removed or changed, else null.
  readPlanes(frame) {
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
      rows.push({ label: plane.semanticLabel ?? "", pose: poseNumbers(pose.transform), polygon });
    }
    return rows;
  }
}

// Returns the frame's own time if it uses this page's clock, else the current time.
function frameTime(time) {
  const own = performance.timeOrigin + time;
  const here = now();
  return Math.abs(own - here) < 1000 ? own : here;
}

function packBytes(flags, ms, rows, planes) {
  const floats = rows.flat();
  const text = planes ? new TextEncoder().encode(JSON.stringify(planes)) : new Uint8Array(0);
  const bytes = new Uint8Array(HEADSET_BYTES + 4 * floats.length + text.length);
  const view = new DataView(bytes.buffer);
  writeHeadset(view, 0, { kind: DEVICE.headset, flags, time: ms });
  floats.forEach((value, i) => view.setFloat32(HEADSET_BYTES + 4 * i, value, true));
  bytes.set(text, HEADSET_BYTES + 4 * floats.length);
  return bytes;
}
