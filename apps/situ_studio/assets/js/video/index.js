// Opens compressed streams. The page loads this module with its first panel that shows one.

import { PacketIndex, readColumns } from "./packet_index.js";
import { openDecoder } from "./decoder.js";
import { VideoSource } from "./source.js";

const decodeBase64 = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

// Opens a stream from the server's description. Returns {source, start}, where `start` is the zero of the index's times
// (ns since 1970), or the reason why this page cannot decode it.
/**
 * @param {any} described
 * @param {object} options
 * @param {(first: number, count: number) => Promise<ArrayBuffer>} options.fetchBytes
 * @param {() => void} options.changed
 * @param {(reason: string) => void} options.failed
 * @returns {Promise<{source: VideoSource, start: bigint, reason?: undefined} | {reason: string}>}
 */
export async function openVideo(described, options) {
  const { codec, rotation, count } = described;
  const description = decodeBase64(described.description);
  /** @type {VideoSource | null} */
  let source = null;
  const { decoder, reason } = await openDecoder({
    codec,
    description,
    rotation,
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
