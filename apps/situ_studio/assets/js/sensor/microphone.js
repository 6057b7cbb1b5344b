// Sends the microphone's audio as 16-bit samples in chunks of 20 ms, each with the time of its end.
import { DEVICE, MICROPHONE_BYTES, writeMicrophone } from "../data/frames.js";
import { now } from "../device/clock.js";

export class Microphone {
  static async start(stream, socket, state) {
    const context = new AudioContext();
    await context.audioWorklet.addModule(new URL("assets/sensor-worklet.js", document.baseURI));
    const source = context.createMediaStreamSource(new MediaStream(stream.getAudioTracks()));
    const node = new AudioWorkletNode(context, "situ-pieces", { numberOfOutputs: 0 });
    source.connect(node);
    return new Microphone(context, node, socket, state);
  }

  constructor(context, node, socket, state) {
    this.context = context;
    this.socket = socket;
    this.state = state;
    /** @type {number | null} the time of the first sample, by the page's clock */
    this.began = null;
    this.frames = 0;
    node.port.onmessage = ({ data }) => this.sendChunk(data);
  }

  sendChunk(samples) {
    const rate = this.context.sampleRate;
    this.frames += samples.length;
    const length = (this.frames / rate) * 1000;
    // Chunks arrive irregularly, but samples are regular, so the clock corrects the sample count slowly, and
    // immediately after a gap.
    const before = this.began ?? -Infinity;
    const off = now() - (before + length);
    const began = Math.abs(off) > 500 ? now() - length : before + off * 0.01;
    this.began = began;
    if (this.state.offset === null || this.socket.readyState !== 1) return;
    const bytes = new ArrayBuffer(MICROPHONE_BYTES + samples.length * 2);
    const view = new DataView(bytes);
    writeMicrophone(view, 0, { kind: DEVICE.microphone, rate, time: began + length });
    for (let i = 0; i < samples.length; i++)
      view.setInt16(MICROPHONE_BYTES + 2 * i, Math.max(-1, Math.min(1, samples[i])) * 32767, true);
    this.socket.send(bytes);
    this.state.heard += samples.length;
  }

  stop() {
    this.context.close();
  }
}
