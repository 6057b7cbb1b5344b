// Plays the pipeline's audio without gaps. Late audio restarts a little ahead.
const AHEAD_S = 0.08;

export class Player {
  constructor(state) {
    this.state = state;
    this.context = new AudioContext();
    this.until = 0;
  }

  playData(data) {
    const view = new DataView(data);
    if (view.getUint8(0) !== 3) return;
    const n = (data.byteLength - 8) >> 1;
    const buffer = this.context.createBuffer(1, n, view.getUint32(4, true));
    const samples = buffer.getChannelData(0);
    for (let i = 0; i < n; i++) samples[i] = view.getInt16(8 + 2 * i, true) / 32768;
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
