import test from "node:test";
import assert from "node:assert/strict";
import {
  FORMAT,
  FRAME_BYTES,
  FRAME_FLAG,
  KIND,
  REPLY_BYTES,
  REPLY_FLAG,
  writeFrame,
  writeReply,
} from "../../js/data/frames.js";
import { DataClient } from "../../js/data/client.js";
import { createStore } from "../../js/time/view.js";

// A minimal server: one signal with a message every 10 ms, which grows with `head`.
class Server {
  constructor() {
    this.readyState = 1;
    this.head = 60e9;
    this.lag = 0;
    this.inFlight = 0;
    this.most = 0;
    this.asked = [];
    queueMicrotask(() => this.onopen());
  }

  close() {}

  send(text) {
    this.inFlight++;
    this.most = Math.max(this.most, this.inFlight);
    const request = JSON.parse(text);
    this.asked.push(request);
    setTimeout(() => {
      this.inFlight--;
      this.onmessage({ data: this.encodeReply(request) });
    }, 1);
  }

  encodeReply(request) {
    const frames = request.series.map(([channel, from, to]) => {
      const a = Math.max(Math.ceil(Number(from) / 1e7) - 1, 0);
      const b = Math.min(Math.floor(Number(to) / 1e7), Math.floor((this.head - this.lag) / 1e7));
      const t = [];
      for (let i = a; i <= b; i++) t.push(i * 1e7);
      return { channel, t };
    });
    const size = REPLY_BYTES + frames.reduce((n, f) => n + FRAME_BYTES + 40 * f.t.length, 0);
    const v = new DataView(new ArrayBuffer(size));
    const data = { from: 0n, to: BigInt(this.head), count: frames.length, version: 0, time: 0n };
    writeReply(v, 0, { format: FORMAT.reply, flags: REPLY_FLAG.live, request: request.req, ...data });
    let at = REPLY_BYTES;
    for (const f of frames) {
      const n = f.t.length;
      const rows = { channel: f.channel, bytes: 40 * n, count: n, time: 0n, step: 0n };
      writeFrame(v, at, { kind: KIND.series, flags: FRAME_FLAG.raw, ...rows });
      at += FRAME_BYTES;
      f.t.forEach((t, i) => v.setFloat64(at + 8 * i, t, true));
      at += 40 * n;
    }
    return v.buffer;
  }
}

test("a live window grows in order under zooms and changes, with one request in flight", async () => {
  const server = new Server();
  const time = createStore();
  const client = new DataClient({ connect: () => server, time });
  time.subscribe(() => client.pump());
  const channel = client.openChannel({ stream: "s", draw: "line" }, () => {}, { px: () => 600 });
  client.start();
  const waitFor = (ms) => new Promise((r) => setTimeout(r, ms));
  await waitFor(20);
  time.dispatch({ type: "live", on: true });
  for (let i = 0; i < 40; i++) {
    server.head += 33e6;
    if (i % 7 === 0) time.dispatch({ type: "zoomAt", t: 0, factor: i % 2 ? 3 : 0.4 });
    client.pump(true);
    await waitFor(6);
  }
  await waitFor(120);
  client.stop();
  assert.ok(server.asked.length < 25, `${server.asked.length} requests in 400 ms`);
  const { series } = channel;
  assert.equal(server.most, 1);
  for (let i = 1; i < series.length; i++) {
    assert.equal(series.t[i] - series.t[i - 1], 1e7, `row ${i} follows the one before`);
  }
  assert.equal(series.t[series.length - 1], Math.floor(server.head / 1e7) * 1e7);
  const [from] = time.get().view;
  assert.ok(series.t[0] <= Math.max(from, 0) + 1e7, "the window reaches the left edge");
});

test("a stopped client sends no more requests, even if a reply was in flight", async () => {
  const server = new Server();
  const time = createStore();
  const client = new DataClient({ connect: () => server, time });
  client.openChannel({ stream: "s", draw: "line" }, () => {}, { px: () => 600 });
  client.start();
  await new Promise((r) => setTimeout(r, 20));
  time.dispatch({ type: "live", on: true });
  client.pump(true);
  client.stop();
  const asked = server.asked.length;
  await new Promise((r) => setTimeout(r, 150));
  assert.equal(server.asked.length, asked);
});

test("messages that arrive later than those of other streams are shown", async () => {
  const server = new Server();
  server.lag = 5e9;
  const time = createStore();
  const client = new DataClient({ connect: () => server, time });
  time.subscribe(() => client.pump());
  const { series } = client.openChannel({ stream: "s", draw: "line" }, () => {}, { px: () => 600 });
  client.start();
  const waitFor = (ms) => new Promise((r) => setTimeout(r, ms));
  await waitFor(20);
  time.dispatch({ type: "live", on: true });
  for (let i = 0; i < 20; i++) {
    server.head += 200e6;
    client.pump(true);
    await waitFor(10);
  }
  await waitFor(120);
  client.stop();
  for (let i = 1; i < series.length; i++)
    assert.equal(series.t[i] - series.t[i - 1], 1e7, `row ${i} follows the one before`);
  assert.equal(series.t[series.length - 1], Math.floor((server.head - server.lag) / 1e7) * 1e7);
});
