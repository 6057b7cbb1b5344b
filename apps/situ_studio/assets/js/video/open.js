// Opens compressed streams from the server's descriptions.

import { PacketIndex, readColumns } from "./packet_index.js";
import { openDecoder } from "./decoder.js";
import { VideoSource } from "./source.js";

const decodeBase64 = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// A page asks for small copies that are being made every so many ms.
const ASK_AGAIN = 3000;
// Key frames that are closer than this many packets need no small copies.
const CLOSE = 24;

// Opens small copies of the images, which are shown while the cursor moves. Returns null if there are none, or if the
// key frames of the stream are so close that none are needed.
/**
 * @param {VideoSource} source
 * @param {object} options
 * @param {() => Promise<any>} options.describe
 * @param {(first: number, count: number) => Promise<ArrayBuffer>} options.fetchBytes
 * @param {() => void} options.changed
 * @param {() => boolean} options.closed
 */
export async function openSmall(source, { describe, fetchBytes, changed, closed }) {
  if (source.index.longestGroup() < CLOSE) return null;
  for (;;) {
    const described = await describe();
    if (closed() || (!described.codec && !described.pending)) return null;
    if (described.codec) {
      const found = await openVideo(described, { fetchBytes, changed, failed: () => {}, share: SMALL_SHARE });
      return found.reason === undefined ? found : null;
    }
    await new Promise((resolve) => setTimeout(resolve, ASK_AGAIN));
  }
}

// The part of the memory for decoded images that small copies get.
const SMALL_SHARE = 0.1;

// Opens a stream from the server's description. Returns {source, start}, where `start` is the zero of the index's times
// (ns since 1970), or the reason why this page cannot decode it.
/**
 * @param {any} described
 * @param {object} options
 * @param {(first: number, count: number) => Promise<ArrayBuffer>} options.fetchBytes
 * @param {() => void} options.changed
 * @param {(reason: string) => void} options.failed
 * @param {number} [options.share] the part of the memory for decoded images, compared with other streams
 * @returns {Promise<{source: VideoSource, start: bigint, reason?: undefined} | {reason: string}>}
 */
export async function openVideo(described, options) {
  const { codec, rotation, count, width, height } = described;
  const description = decodeBase64(described.description);
  /** @type {VideoSource | null} */
  let source = null;
  const { decoder, reason } = await openDecoder({
    codec,
    description,
    rotation,
    width,
    height,
    colorStated: described.color !== null,
    accept: (number, image, bytes) => (source ? source.accept(number, image, bytes) : image.close()),
    fail: (text) => source?.giveUp(text),
  });
  if (!decoder) return { reason: reason ?? "this browser does not decode it" };
  const columns = readColumns(await inflate(decodeBase64(described.packets)), count);
  source = new VideoSource({ index: new PacketIndex(columns), codec, description, ...options });
  source.run(decoder);
  return { source, start: BigInt(described.start) };
}
