import { test } from "node:test";
import assert from "node:assert/strict";
import { SequenceDecoder } from "../../js/video/decoder.js";

test("waiting for a full decoder leaves no timers and listeners behind", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const listeners = [];
  class FakeVideoDecoder {
    state = "configured";
    decodeQueueSize = 99;
    addEventListener(_name, listener) {
      listeners.push(listener);
    }
    close() {}
  }
  globalThis.VideoDecoder = FakeVideoDecoder;
  const decoder = new SequenceDecoder({ rotation: 0, accept: () => {}, fail: () => {} }, { codec: "vp8" });
  let done = false;
  const waiting = decoder.ready().then(() => (done = true));
  for (let i = 0; i < 50; i++) {
    for (const listener of [...listeners]) listener();
    t.mock.timers.tick(20);
    await new Promise((resolve) => setImmediate(resolve));
    assert.deepEqual([listeners.length, decoder.waiting.length, done], [1, 1, false]);
  }
  decoder.decoder.decodeQueueSize = 2;
  listeners[0]();
  await waiting;
  assert.equal(done, true);
  decoder.close();
  delete globalThis.VideoDecoder;
});
