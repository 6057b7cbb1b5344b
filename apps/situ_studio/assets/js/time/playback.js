// Moves the cursor while playing: by the clock of the page, or by the clock of the sound when there is any.

const CHUNK = 1e9;
const AHEAD = 2;
const MAX_AUDIBLE = 4;

export class Playback {
  // time: store; sounds(): [{stream, channel}] to be heard; fetchPcm({stream, channel}, from, to) -> {rate, samples,
  // at}
  constructor({ time, sounds, fetchPcm, onError = () => {} }) {
    Object.assign(this, { time, sounds, fetchPcm, onError });
    this.run = null;
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
    const frame = (now) => {
      if (run.stop) return;
      requestAnimationFrame(frame);
      if (run.waiting) {
        run.last = now;
        return;
      }
      const elapsed = (now - run.last) * 1e6;
      run.last = now;
      if (run.clock) this.time.dispatch({ type: "tick", at: run.clock() });
      else this.time.dispatch({ type: "tick", elapsed });
    };
    requestAnimationFrame(frame);
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
      this.context ??= new AudioContext();
      run.waiting = true;
      await this.context.resume();
      const first = await Promise.all(sounds.map((x) => this.chunk(x, from, to)));
      if (run.stop) return;
      const start = this.context.currentTime + 0.03;
      const play = (chunks) => {
        for (const c of chunks) this.schedule(run, c, from, start);
      };
      run.waiting = false;
      run.heard = 0;
      run.clock = () => from + Math.max(0, this.context.currentTime - start) * 1e9 * run.speed;
      play(first);
      for (let at = from + CHUNK; at < to && !run.stop; at += CHUNK) {
        play(await Promise.all(sounds.map((x) => this.chunk(x, at, to))));
        while (!run.stop && at - this.time.get().cursor > AHEAD * CHUNK * Math.max(run.speed, 1)) {
          await new Promise((r) => setTimeout(r, 100));
        }
      }
    } catch (error) {
      // without sound the pictures go on
      run.waiting = false;
      run.clock = null;
      this.onError(`no sound: ${error.message}`);
    }
  }

  chunk(sound, from, end) {
    return this.fetchPcm(sound, from, Math.min(from + CHUNK, end));
  }

  schedule(run, pcm, from, start) {
    if (!pcm || !pcm.samples.length || run.stop) return;
    const buffer = this.context.createBuffer(pcm.channels, pcm.samples.length / pcm.channels, pcm.rate);
    for (let c = 0; c < pcm.channels; c++) buffer.copyToChannel(everyOther(pcm.samples, c, pcm.channels), c);
    const node = this.context.createBufferSource();
    node.buffer = buffer;
    node.playbackRate.value = run.speed;
    node.connect(this.context.destination);
    let when = start + (pcm.at - from) / 1e9 / run.speed;
    let offset = 0;
    const now = this.context.currentTime;
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

// One channel of samples that lie frame by frame.
function everyOther(samples, channel, channels) {
  if (channels === 1) return samples;
  const out = new Float32Array(samples.length / channels);
  for (let i = 0; i < out.length; i++) out[i] = samples[i * channels + channel];
  return out;
}
