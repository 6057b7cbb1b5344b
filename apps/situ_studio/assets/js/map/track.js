// The track of one stream over the whole recording, requested once and again when the recording has grown.

import { Channel } from "../data/channels.js";
import { KIND } from "../data/frames.js";
import { toX, toY } from "./mercator.js";

// Requested again after the recording has grown by this share of its length, and by at least this many ns.
const GROWN = 0.02;
const LEAST = 1e9;
// The server reads messages, not bins.
const BINS = 1000;

export class TrackChannel extends Channel {
  gatherRequest(message, s, origin) {
    const [from, to] = s.data;
    const { held } = this;
    if (this.asking || !(to >= from)) return;
    if (held && to - held.to < Math.max(GROWN * (held.to - held.from), LEAST) && from >= held.from) return;
    if (held && to === held.to) return;
    this.asking = { from, to };
    const toAbsolute = (t) => (origin + BigInt(Math.round(t))).toString();
    message.series.push([this.id, toAbsolute(from), toAbsolute(to), Math.max(1, Math.ceil((to - from) / BINS))]);
  }

  reopen() {
    super.reopen();
    this.held = this.asking = null;
  }

  receiveFrame(f, client) {
    this.held = this.asking ?? this.held;
    this.asking = null;
    this.error = f.kind === KIND.error ? f.message : null;
    const findLine = (name) => f.lines?.find((l) => l.name === name);
    const [latitude, longitude] = [findLine("latitude"), findLine("longitude")];
    if (latitude && longitude) this.accept(buildTrack(latitude, longitude, client.toRelative(f.time)), this);
    else this.accept(null, this);
  }
}

// Builds a track: times and positions on the Mercator square. Longitudes are unwrapped at the date line.
export function buildTrack(latitude, longitude, base) {
  const n = latitude.count;
  const t = new Float64Array(n),
    x = new Float64Array(n),
    y = new Float64Array(n);
  let turn = 0;
  for (let i = 0; i < n; i++) {
    t[i] = base + latitude.t[i];
    if (i) {
      const step = longitude.last[i] - longitude.last[i - 1];
      if (step > 180) turn -= 360;
      else if (step < -180) turn += 360;
    }
    x[i] = toX(longitude.last[i] + turn);
    y[i] = toY(latitude.last[i]);
  }
  return { count: n, t, x, y };
}

// Returns the number of points at or before a time.
export function countUntil(track, time) {
  let low = 0,
    high = track.count;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (track.t[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

// Returns the index of the point nearest to a position within a distance, or -1.
export function nearestPoint(track, x, y, within) {
  let best = -1,
    least = within * within;
  for (let i = 0; i < track.count; i++) {
    const d = (track.x[i] - x) ** 2 + (track.y[i] - y) ** 2;
    if (d <= least) [best, least] = [i, d];
  }
  return best;
}
