// Moves the cursor during playback: by the page's clock, or by the audio clock if there is audio.

const CHUNK = 1e9;
const AHEAD = 2;
const MAX_AUDIBLE = 4;

export class Playback {
  // time: store; sounds(): [{stream, channel}] to play; fetchPcm({stream, channel}, from, to) -> {rate, samples, at}
  /** @param {{time: any, sounds: () => any[], fetchPcm: Function, onError?: (text: string) => void}} options */
  constructor({ time, sounds, fetchPcm, onError = () => {} }) {
    this.time = time;
    this.sounds = sounds;
    this.fetchPcm = fetchPcm;
    this.onError = onError;
    this.run = null;
    /** @type {AudioContext | undefined} */
    this.context = undefined;
    time.subscribe((s, old) => {
      const was = old.mode === "play",
        is = s.mode === "play";
      if (is && !was) this.begin();
      else if (!is && was) this.end();
      else if (is && (s.speed !== old.speed || s.cursor < old.cursor || s.play !== old.play)) {
        this.end();
        this.begin();
      }
    });
  }

  begin() {
    const s = this.time.get();
    const run = { last: performance.now(), speed: s.speed, stop: false, nodes: new Set() };
    this.run = run;
    const sounds = s.speed <= MAX_AUDIBLE && s.speed >= 1 / MAX_AUDIBLE ? this.sounds() : [];
    if (sounds.length) this.startSound(run, sounds, s);
    const advanceFrame = (now) => {
      if (run.stop) return;
      requestAnimationFrame(advanceFrame);
      if (run.waiting) {
        run.last = now;
        return;
      }
      const elapsed = (now - run.last) * 1e6;
      run.last = now;
      if (run.clock) this.time.dispatch({ type: "tick", at: run.clock() });
      else this.time.dispatch({ type: "tick", elapsed });
    };
    requestAnimationFrame(advanceFrame);
  }

  end() {
    if (!this.run) return;
    this.run.stop = true;
    for (const n of this.run.nodes) n.stop();
    this.run = null;
  }

  async startSound(run, sounds, s) {
    const from = s.cursor,
      to = s.play[1];
    try {
      const context = this.openContext();
      run.waiting = true;
      await context.resume();
      const first = await Promise.all(sounds.map((x) => this.fetchChunk(x, from, to)));
      if (run.stop) return;
      const start = context.currentTime + 0.03;
      const playChunks = (chunks) => {
        for (const c of chunks) this.scheduleChunk(run, c, from, start);
      };
      run.waiting = false;
      run.heard = 0;
      let heard = from;
      // the cursor never goes back, even if the latency grows
      run.clock = () => (heard = Math.max(heard, from + (audibleTime(context) - start) * 1e9 * run.speed));
      playChunks(first);
      for (let at = from + CHUNK; at < to && !run.stop; at += CHUNK) {
        playChunks(await Promise.all(sounds.map((x) => this.fetchChunk(x, at, to))));
        while (!run.stop && at - this.time.get().cursor > AHEAD * CHUNK * Math.max(run.speed, 1)) {
          await new Promise((r) => setTimeout(r, 100));
        }
      }
    } catch (error) {
      // without audio, playback continues silently
      run.waiting = false;
      run.clock = null;
      this.onError(`no audio: ${error.message}`);
    }
  }

  openContext() {
    this.context ??= new AudioContext();
    return this.context;
  }

  fetchChunk(sound, from, end) {
    return this.fetchPcm(sound, from, Math.min(from + CHUNK, end));
  }

  scheduleChunk(run, pcm, from, start) {
    if (!pcm || !pcm.samples.length || run.stop) return;
    const context = this.openContext();
    const buffer = context.createBuffer(pcm.channels, pcm.samples.length / pcm.channels, pcm.rate);
    for (let c = 0; c < pcm.channels; c++) buffer.copyToChannel(pickChannel(pcm.samples, c, pcm.channels), c);
    const node = context.createBufferSource();
    node.buffer = buffer;
    node.playbackRate.value = run.speed;
    node.connect(context.destination);
    let when = start + (pcm.at - from) / 1e9 / run.speed;
    let offset = 0;
    const now = context.currentTime;
    if (when < now) {
      offset = (now - when) * run.speed;
      when = now;
    }
    if (offset >= buffer.duration) return;
    node.start(when, offset);
    run.nodes.add(node);
    run.heard += buffer.length;
    node.onended = () => run.nodes.delete(node);
  }
}

// Returns the time of the sample that is heard now, in the seconds of the context. The device plays a sample some time
// after the context has processed it, for Bluetooth up to 0.3 s.
/** @param {AudioContext} context */
export function audibleTime(context) {
  const latency = context.outputLatency;
  return context.currentTime - (latency > 0 && latency < 1 ? latency : 0);
}

// Returns one channel of interleaved samples.
function pickChannel(samples, channel, channels) {
  if (channels === 1) return samples;
  const out = new Float32Array(samples.length / channels);
  for (let i = 0; i < out.length; i++) out[i] = samples[i * channels + channel];
  return out;
}
