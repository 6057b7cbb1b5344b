import { test } from "node:test";
import assert from "node:assert/strict";
import { packetReader } from "../../js/video/nal.js";

const avcC = Uint8Array.from([1, 0x64, 0, 0x28, 0xff, 0xe1]);
// Builds a packet from units [header, length of the rest].
const lengths = (...units) =>
  Uint8Array.from(units.flatMap(([header, n]) => [0, 0, 0, n + 1, header, ...Array(n).fill(0x11)]));
const startCodes = (...units) =>
  Uint8Array.from(units.flatMap(([header, n]) => [0, 0, 1, header, ...Array(n).fill(0x11)]));

test("H.264: a decoder starts at an IDR image, after parameters and other information", () => {
  const reader = packetReader("avc1.640028", avcC);
  assert.ok(reader.startsDecoding(lengths([6, 30], [0x67, 9], [0x68, 4], [0x65, 90])));
  assert.ok(!reader.startsDecoding(lengths([6, 30], [0x41, 90])), "an I-frame without IDR");
});

test("H.264: images with a reference count of 0 are not needed", () => {
  const reader = packetReader("avc1.640028", avcC);
  assert.ok(reader.needed(lengths([6, 3], [0x41, 9])));
  assert.ok(!reader.needed(lengths([6, 3], [0x01, 9])));
  const annexB = packetReader("avc1.42c01e", new Uint8Array());
  assert.ok(annexB.startsDecoding(startCodes([9, 1], [0x67, 4], [0x65, 9])));
  assert.ok(!annexB.needed(startCodes([9, 1], [0x01, 9])));
});

test("damaged lengths end the search", () => {
  const reader = packetReader("avc1.640028", avcC);
  for (const bytes of [[], [0], [0xff, 0xff, 0xff, 0xff, 0x41], [0, 0, 0, 0, 6, 0, 0, 0, 0]])
    assert.equal(reader.startsDecoding(Uint8Array.from(bytes)), false);
});

test("other codecs are taken as the index describes them", () => {
  for (const codec of ["vp8", "vp09.00.62.08", "av01.0.08M.08", "jpeg"])
    assert.equal(packetReader(codec, new Uint8Array()), null);
});
