import test from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { decodeReply } from "../../js/data/wire.js";
import { KIND, PIXELS } from "../../js/data/frames.js";
import { generateFrames, output } from "../../frames.mjs";

// The server's test (frame_schema_test.exs) encodes the same bytes.
const golden = readFileSync(new URL("../../../test/golden/reply.hex", import.meta.url), "utf8").replace(/\n/g, "");
const bytes = new Uint8Array(Buffer.from(golden, "hex"));

test("frames.js matches the schema (run `npm run frames`)", async () => {
  assert.equal(readFileSync(output, "utf8"), await generateFrames());
});

test("a reply with every kind of frame is decoded", () => {
  const { frames, ...reply } = decodeReply(bytes.buffer);
  assert.deepEqual(reply, {
    request: 7,
    live: true,
    gone: false,
    replaced: true,
    from: -1000n,
    to: 9_000_000_000_000_000_000n,
    version: 3,
    time: 5000n,
  });
  assert.deepEqual(
    frames.map((f) => f.kind),
    Object.values(KIND),
  );
  assert.deepEqual(
    frames.map((f) => f.channel),
    frames.map((_, i) => i + 1),
  );
  const [series, segments, marks, image, json, , , error, pcm, lines, scene, sounds] = frames;
  assert.equal(series.sampled, true);
  assert.equal(series.raw, false);
  assert.equal(series.time, 1000n);
  assert.deepEqual([...series.t], [0, 1000]);
  assert.deepEqual([...series.max], [2, NaN]);
  assert.deepEqual([...series.n], [3, 0]);
  assert.equal(segments.step, 2500);
  assert.deepEqual(segments.value[1], [2000, null, "rests", "text", "left"]);
  assert.deepEqual([...marks.latency], [20, 30]);
  const { width, height, pixels, unit, data } = image;
  assert.deepEqual([width, height, pixels, unit, ...data], [2, 1, PIXELS.gray16, 1000, 1, 0, 2, 0]);
  assert.deepEqual(json.value, { speed: 1.5 });
  assert.equal(error.message, "no such stream");
  assert.deepEqual([pcm.rate, pcm.channels, ...pcm.samples], [48_000, 2, 0.5, -0.5]);
  assert.deepEqual(
    lines.lines.map((l) => [l.name, ...l.t, ...l.last]),
    [
      ["left", 0, 1],
      ["right", 1000, 0.5],
    ],
  );
  assert.equal(lines.step, 4);
  assert.deepEqual([...scene.items[0].position], [1, 2, 3]);
  assert.deepEqual(scene.problems, ["a problem"]);
  assert.deepEqual([sounds.rate, ...sounds.t, ...sounds.samples], [16_000, 0, 1000, 0.25, -0.25]);
});
