// The way of one stream over the whole recording: asked for once, and again when the recording has grown.

import { Channel } from "../data/channels.js";
import { KIND } from "../data/wire.js";
import { toX, toY } from "./mercator.js";

// Asked for again when the data have grown by a part of themselves, and not more often than that many ns.
const GROWN = 0.02;
const LEAST = 1e9;
// The server reads messages, not bins.
const BINS = 1000;

export class TrackChannel extends Channel {
  gather(message, s, origin) {
    const [from, to] = s.data;
    const { held } = this;
    if (this.asking || !(to >= from)) return;
    if (held && to - held.to < Math.max(GROWN * (held.to - held.from), LEAST) && from >= held.from) return;
    if (held && to === held.to) return;
    this.asking = { from, to };
    const abs = (t) => (origin + BigInt(Math.round(t))).toString();
    message.series.push([this.id, abs(from), abs(to), Math.max(1, Math.ceil((to - from) / BINS))]);
  }

  reopen() {
    super.reopen();
    this.held = this.asking = null;
  }

  receive(f, client) {
    this.held = this.asking ?? this.held;
    this.asking = null;
    this.error = f.kind === KIND.error ? f.message : null;
    const of = (name) => f.lines?.find((l) => l.name === name);
    const [latitude, longitude] = [of("latitude"), of("longitude")];
    if (latitude && longitude) this.accept(way(latitude, longitude, client.rel(f.time)), this);
    else this.accept(null, this);
  }
}

// Times, places and the places on the square of the map. Longitudes go on where they pass the line of dates.
export function way(latitude, longitude, base) {
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

// How many points of a way lie at or before a time.
export function until(track, time) {
  let low = 0,
    high = track.count;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (track.t[middle] <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}

// The point nearest to a place, within a distance: its number, or -1.
export function nearest(track, x, y, within) {
  let best = -1,
    least = within * within;
  for (let i = 0; i < track.count; i++) {
    const d = (track.x[i] - x) ** 2 + (track.y[i] - y) ** 2;
    if (d <= least) [best, least] = [i, d];
  }
  return best;
}
