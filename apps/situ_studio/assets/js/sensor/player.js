// Plays the pipeline's audio without gaps. Late audio restarts a little ahead.
import { DEVICE, SPEAKER_BYTES, readSpeaker } from "../data/frames.js";

const AHEAD_S = 0.08;

export class Player {
  constructor(state) {
    this.state = state;
    this.context = new AudioContext();
    this.until = 0;
  }

  playData(data) {
    const view = new DataView(data);
    const { kind, rate } = readSpeaker(view, 0);
    if (kind !== DEVICE.speaker) return;
    const n = (data.byteLength - SPEAKER_BYTES) >> 1;
    const buffer = this.context.createBuffer(1, n, rate);
    const samples = buffer.getChannelData(0);
    for (let i = 0; i < n; i++) samples[i] = view.getInt16(SPEAKER_BYTES + 2 * i, true) / 32768;
    const source = this.context.createBufferSource();
    source.buffer = buffer;
    source.connect(this.context.destination);
    if (this.until < this.context.currentTime) this.until = this.context.currentTime + AHEAD_S;
    source.start(this.until);
    this.until += buffer.duration;
    source.onended = () => (this.state.played += n);
  }

  stop() {
    this.context.close();
  }
}
