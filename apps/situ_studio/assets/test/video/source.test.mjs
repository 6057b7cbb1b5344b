import { test } from "node:test";
import assert from "node:assert/strict";
import { VideoSource } from "../../js/video/source.js";
import { PacketIndex } from "../../js/video/packet_index.js";

const COUNT = 600,
  GROUP = 100;
const makeIndex = () =>
  new PacketIndex({
    times: Float64Array.from({ length: COUNT }, (_, p) => p * 40),
    sizes: new Uint32Array(COUNT).fill(10_000),
    flags: Uint8Array.from({ length: COUNT }, (_, p) => (p % GROUP === 0 ? 1 : 0)),
  });

// A decoder like that of a browser: it needs a key frame first, and returns an image `delay` packets later.
class FakeDecoder {
  constructor(source, delay) {
    Object.assign(this, { source, delay, queue: [], begun: false, alive: new Set() });
  }
  start() {
    this.queue = [];
    this.begun = false;
  }
  feed(_bytes, key, number) {
    assert.ok(this.begun || key, "a decoder starts at a key frame");
    this.begun = true;
    this.queue.push(number);
    while (this.queue.length > this.delay) this.emit();
  }
  emit() {
    const number = this.queue.shift();
    const image = { number, close: () => assert.ok(this.alive.delete(image), "closed twice") };
    this.alive.add(image);
    this.source.accept(number, image, 1e6);
  }
  async ready() {
    await new Promise((resolve) => setImmediate(resolve));
  }
  async drain() {}
  async flush() {
    while (this.queue.length) this.emit();
    this.begun = false;
  }
  close() {}
}

function open({ delay = 4, fetchBytes } = {}) {
  const failures = [];
  const fetched = async (first, count) => new ArrayBuffer(count * 10_000);
  const source = new VideoSource({
    index: makeIndex(),
    codec: "vp8",
    description: new Uint8Array(),
    fetchBytes: fetchBytes ?? fetched,
    changed: () => {},
    failed: (reason) => failures.push(reason),
  });
  const decoder = new FakeDecoder(source, delay);
  source.run(decoder);
  return { source, decoder, failures };
}

const until = async (holds, what) => {
  for (let i = 0; i < 20_000 && !holds(); i++) await new Promise((resolve) => setImmediate(resolve));
  assert.ok(holds(), what);
};

test("random jumps end at the right image, with bounded memory", async () => {
  const { source, decoder, failures } = open();
  let seed = 3;
  for (let i = 0; i < 60; i++) {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    const image = i === 30 ? COUNT - 1 : seed % COUNT;
    source.setTarget(image, 0);
    await until(() => !source.pending, `image ${image} is decoded`);
    const found = source.current();
    assert.deepEqual([found.number, found.image.number, found.exact], [image, image, true]);
    assert.ok(source.cache.bytes <= source.cache.limit + 1e6);
    assert.equal(decoder.alive.size, source.cache.frames.size);
  }
  assert.deepEqual(failures, []);
  source.close();
  assert.equal(decoder.alive.size, 0, "every image was closed");
});

test("at rest, the images after the cursor are decoded, as far as there is memory for them", async () => {
  const { source } = open();
  source.cache.limit = 50e6;
  source.setTarget(120, 0);
  await until(() => !source.pending, "the image is decoded");
  source.fillAhead();
  await until(() => source.cache.has(142), "the images after it are decoded");
  assert.ok(source.cache.has(120) && source.cache.bytes <= source.cache.limit);
  assert.equal(source.stats.starts, 1);
  source.close();
});

test("with small copies, a moving cursor does not start the decoder again and again", async () => {
  const { source } = open();
  source.patient = true;
  for (let i = 0; i < 200; i++) {
    source.setTarget((i * 137) % COUNT, 0);
    await new Promise((resolve) => setImmediate(resolve));
  }
  assert.ok(source.stats.starts <= 2, `${source.stats.starts} starts`);
  source.setTarget(450, 0);
  while (source.pending) await new Promise((resolve) => setTimeout(resolve, 5));
  assert.equal(source.current().number, 450);
  source.close();
});

test("streams share the memory for decoded images", () => {
  const [{ source: a }, { source: b }] = [open(), open()];
  assert.equal(a.cache.limit, b.cache.limit);
  const half = a.cache.limit;
  b.close();
  assert.equal(a.cache.limit, 2 * half);
  a.close();
});

test("a cursor that never stops still shows images", async () => {
  const { source } = open();
  let shown = 0;
  for (let i = 0; i < 400; i++) {
    source.setTarget((i * 37) % COUNT, 0);
    await new Promise((resolve) => setImmediate(resolve));
    const found = source.current();
    if (found) shown++;
  }
  assert.ok(shown > 300, `${shown} of 400`);
  assert.ok(source.stats.decoded > 50, `${source.stats.decoded} images`);
  source.close();
});

test("a server that refuses makes the source give up, with its reason", async () => {
  const fetchBytes = async () => {
    throw Object.assign(new Error("the packets are not where the index states"), { status: 422 });
  };
  const { source, failures } = open({ fetchBytes });
  source.setTarget(50, 0);
  await until(() => failures.length > 0, "it gives up");
  assert.deepEqual([failures, source.closed], [["the packets are not where the index states"], true]);
});

test("a server that is away is asked again", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let away = true;
  const fetchBytes = async (_first, count) => {
    if (away) throw new TypeError("Failed to fetch");
    return new ArrayBuffer(count * 10_000);
  };
  const { source, failures } = open({ fetchBytes });
  source.setTarget(50, 0);
  await until(() => source.offline, "it says that the server is away");
  away = false;
  t.mock.timers.tick(1000);
  await until(() => !source.pending, "it continues");
  assert.deepEqual([source.offline, failures], [false, []]);
  source.close();
});

test("an image that the decoder never returns makes the source give up", async () => {
  const { source, failures } = open({ delay: 1000 });
  source.setTarget(5, 0);
  await until(() => failures.length > 0, "it gives up");
  assert.match(failures[0], /did not return/);
});
