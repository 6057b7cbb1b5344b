// Audio during playback: the waveforms of the panels, fetched one second at a time.

import { KIND } from "../data/frames.js";
import { decodeReply } from "../data/wire.js";

const MOST = 4;

// Lists the visible waveforms that are not muted.
export function listAudible(views) {
  const out = new Map();
  for (const v of views) {
    for (const l of v.layers ?? []) {
      const sound = l.drawer.audibleChannel?.(l.vis);
      if (sound) out.set(sound.stream, sound);
    }
  }
  return [...out.values()].slice(0, MOST);
}

// Fetches the samples of {stream, channel} (a number, or "all" for interleaved channels) between two page times;
// returns null if there are none.
export async function fetchAudio(url, client, { stream, channel }, from, to) {
  const q = new URLSearchParams({ stream, channel, from: client.toAbsolute(from), to: client.toAbsolute(to) });
  const response = await fetch(`${url}&${q}`);
  if (!response.ok) throw new Error(await response.text());
  const f = decodeReply(await response.arrayBuffer()).frames[0];
  if (!f || f.kind !== KIND.pcm) return null;
  return { rate: f.rate, samples: f.samples, channels: f.channels, at: client.toRelative(f.time) };
}
