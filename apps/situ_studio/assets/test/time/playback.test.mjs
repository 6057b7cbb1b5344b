import { test } from "node:test";
import assert from "node:assert/strict";
import { Playback } from "../../js/time/playback.js";

const S = 1e9;

// An audio device whose clock the test moves, and a page whose animation frames the test runs.
function makeStage(speed) {
  const nodes = [];
  const context = {
    currentTime: 5,
    outputLatency: 0,
    resume: async () => {},
    createBuffer: (_channels, length, rate) => ({ length, duration: length / rate, copyToChannel() {} }),
    createBufferSource() {
      const node = {
        playbackRate: { value: 1 },
        connect() {},
        stop() {},
        start: (when, offset) => nodes.push({ node, when, offset }),
      };
      return node;
    },
  };
  globalThis.AudioContext = class {
    constructor() {
      return context;
    }
  };
  const frames = [];
  globalThis.requestAnimationFrame = (run) => frames.push(run);
  let state = { mode: "pause", cursor: 2 * S, speed, play: [0, 60 * S] };
  const listeners = [];
  const time = {
    get: () => state,
    subscribe: (listener) => listeners.push(listener),
    dispatch(action) {
      const old = state;
      state =
        action.type === "tick"
          ? { ...state, cursor: action.at ?? state.cursor + action.elapsed * speed }
          : { ...state, ...action };
      for (const listener of listeners) listener(state, old);
    },
  };
  const fetchPcm = async (_sound, from, to) => ({
    rate: 1000,
    channels: 1,
    samples: new Float32Array(Math.round(((to - from) / S) * 1000)),
    at: from,
  });
  const playback = new Playback({ time, sounds: () => [{ stream: "Audio", channel: 0 }], fetchPcm });
  const frame = (now) => frames.splice(0).forEach((run) => run(now));
  return { playback, time, context, nodes, frame };
}

const settle = () => new Promise((resolve) => setImmediate(resolve));

// Returns the time of the recording that the loudspeaker plays, from what was scheduled.
function playedAt({ nodes, context }, speed) {
  const heard = context.currentTime - context.outputLatency;
  const { when, offset } = nodes[0];
  return 2 * S + (offset + (heard - when) * speed) * S;
}

for (const speed of [1, 2, 4])
  test(`at ${speed}x, the cursor is where the loudspeaker is`, async () => {
    const stage = makeStage(speed);
    const { time, context, frame } = stage;
    time.dispatch({ mode: "play" });
    for (let i = 0; i < 5; i++) await settle();
    for (const [seconds, latency] of [
      [0.5, 0.02],
      [1.1, 0.02],
      [1.7, 0.25],
      [3, 0.25],
    ]) {
      Object.assign(context, { currentTime: 5 + seconds, outputLatency: latency });
      frame(seconds * 1000);
      const apart = Math.abs(time.get().cursor - playedAt(stage, speed)) / speed / 1e6;
      assert.ok(apart < 1, `${apart} ms apart after ${seconds} s`);
    }
    time.dispatch({ mode: "pause" });
  });

test("the cursor does not go back when the latency grows", async () => {
  const { time, context, frame } = makeStage(1);
  time.dispatch({ mode: "play" });
  for (let i = 0; i < 5; i++) await settle();
  context.currentTime = 6;
  frame(1000);
  const before = time.get().cursor;
  context.outputLatency = 0.3;
  context.currentTime = 6.1;
  frame(1100);
  assert.equal(time.get().cursor, before);
  time.dispatch({ mode: "pause" });
});
