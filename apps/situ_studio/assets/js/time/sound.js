// Sound while playing: the sound that the panels show, fetched a second at a time.

import { decode, KIND } from "../data/wire.js";

const MOST = 4;

// Waveforms that are shown are heard, unless muted.
export function sounds(views) {
  const out = new Map();
  for (const v of views) {
    for (const l of v.layers ?? []) {
      const sound = l.drawer.sound?.(l.vis);
      if (sound) out.set(sound.stream, sound);
    }
  }
  return [...out.values()].slice(0, MOST);
}

// Samples of {stream, channel} (a number, or "all": frame by frame) between two times of the page, or null where there
// are none.
export async function fetchSound(url, client, { stream, channel }, from, to) {
  const q = new URLSearchParams({ stream, channel, from: client.abs(from), to: client.abs(to) });
  const response = await fetch(`${url}&${q}`);
  if (!response.ok) throw new Error(await response.text());
  const f = decode(await response.arrayBuffer()).frames[0];
  if (!f || f.kind !== KIND.pcm) return null;
  return { rate: f.rate, samples: f.samples, channels: f.channels, at: client.rel(f.time) };
}
