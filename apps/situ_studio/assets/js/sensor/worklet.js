// Runs in the audio thread: collects the first channel in chunks of 20 ms.
class ChunkProcessor extends AudioWorkletProcessor {
  constructor() {
    super();
    this.piece = new Float32Array(Math.round(sampleRate / 50));
    this.filled = 0;
  }

  process([[channel]]) {
    for (let i = 0; channel && i < channel.length;) {
      const part = channel.subarray(i, i + this.piece.length - this.filled);
      this.piece.set(part, this.filled);
      this.filled += part.length;
      i += part.length;
      if (this.filled === this.piece.length) {
        this.port.postMessage(this.piece.slice());
        this.filled = 0;
      }
    }
    return true;
  }
}

registerProcessor("situ-pieces", ChunkProcessor);
