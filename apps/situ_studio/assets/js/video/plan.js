// Decides what the decoder does next, so that the image at the cursor is decoded as soon as possible.

// Between two key frames, up to this many packets are decoded rather than jumping to the second one.
const NEAR = 4;
// Images that no other image needs are skipped on the way to the cursor, except for this many before it, to which
// somebody may step back.
const BACK = 8;
// A decoder returns an image at the latest after this many further packets.
const DELAY = 48;

/**
 * @typedef {object} Progress
 * @property {number} next the next packet, or -1 before the first
 * @property {Set<number>} pending images whose packets the decoder has, but has not returned yet
 * @property {boolean} flushed whether the decoder has been told to return everything
 */

// Returns the first image that has to be decoded: the one at the cursor, or one of the `ahead` images after it; -1 if
// all of them are there.
export function findMissing(index, cache, target, ahead) {
  if (target < 0) return -1;
  const last = Math.min(target + ahead, index.imageCount - 1);
  for (let i = target; i <= last; i++) if (!cache.has(i)) return i;
  return -1;
}

// Returns "feed" (give the next packet to the decoder), "flush", "lost" (the decoder did not return the image), or the
// key frame where the decoder has to start again.
/**
 * @param {import("./packet_index.js").PacketIndex} index
 * @param {Progress} progress
 * @param {number} image
 * @returns {"feed" | "flush" | "lost" | {start: number}}
 */
export function planStep(index, { next, pending, flushed }, image) {
  const packet = index.packets[image];
  if (pending.has(image)) {
    if (flushed || next > packet + DELAY) return "lost";
    return next >= index.count ? "flush" : "feed";
  }
  const key = index.keyBefore(packet);
  if (next < 0 || flushed || next > packet || key > next + NEAR) return { start: key };
  return "feed";
}

// Returns whether a packet on the way to an image may be skipped if no other image needs it.
export function skippable(index, packet, image) {
  return index.images[packet] >= 0 && index.packets[image] - packet > BACK;
}
