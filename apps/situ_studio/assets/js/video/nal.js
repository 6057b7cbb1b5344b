// Looks into the packets of H.264 and HEVC: whether a decoder can start at one, and whether other images need it.

// Lists the headers of a packet's units (NAL units), each as [type byte, offset]. With a size of lengths, each unit
// begins with its length; otherwise units are separated by start codes (Annex B).
/**
 * @param {Uint8Array} bytes
 * @param {number} lengthSize bytes of a length, or 0
 */
function* unitHeaders(bytes, lengthSize) {
  if (!lengthSize) return yield* startCodeHeaders(bytes);
  for (let at = 0; at + lengthSize < bytes.length;) {
    let length = 0;
    for (let i = 0; i < lengthSize; i++) length = length * 256 + bytes[at + i];
    yield bytes[at + lengthSize];
    at += lengthSize + length;
  }
}

/** @param {Uint8Array} bytes */
function* startCodeHeaders(bytes) {
  for (let at = 0; at + 3 < bytes.length; at++)
    if (bytes[at] === 0 && bytes[at + 1] === 0 && bytes[at + 2] === 1) yield bytes[at + 3];
}

// Returns how a codec's packets are read, or null if they are taken as the index describes them.
/**
 * @param {string} codec
 * @param {Uint8Array} description
 */
export function packetReader(codec, description) {
  if (!codec.startsWith("avc1.")) return null;
  const lengthSize = description.length > 4 ? (description[4] & 3) + 1 : 0;
  return {
    // An image without IDR is not enough: images after it may need images before it.
    startsDecoding: (bytes) => someUnit(bytes, lengthSize, (header) => (header & 31) === 5),
    // Images that no other image needs can be skipped.
    needed: (bytes) => someUnit(bytes, lengthSize, (header) => isSlice(header & 31) && (header & 0x60) !== 0),
  };
}

const isSlice = (type) => type === 1 || type === 2 || type === 5;

function someUnit(bytes, lengthSize, accept) {
  for (const header of unitHeaders(bytes, lengthSize)) if (accept(header)) return true;
  return false;
}
