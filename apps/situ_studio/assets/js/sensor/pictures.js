// Pictures of the camera as JPEG, when the pipeline has room for one; the others are never made.
import { now } from "./clock.js";

const HEAD = 16;

export class Pictures {
  constructor(stream, video, socket, state) {
    Object.assign(this, { video, socket, state, room: 0, busy: false, on: true });
    this.canvas = document.createElement("canvas");
    video.srcObject = new MediaStream(stream.getVideoTracks());
    video.play().catch(() => {}); // stopped before it began
    this.next();
  }

  credit(n) {
    this.room += n;
  }

  next() {
    const look = (_, frame) => {
      if (!this.on) return;
      this.picture(frame?.captureTime ? performance.timeOrigin + frame.captureTime : now());
      this.next();
    };
    if (this.video.requestVideoFrameCallback) this.video.requestVideoFrameCallback(look);
    else setTimeout(look, 33);
  }

  picture(time) {
    const { videoWidth: w, videoHeight: h } = this.video;
    if (!w) return;
    if (this.room < 1 || this.busy || this.state.offset === null) return void this.state.dropped++;
    this.room--;
    this.busy = true;
    this.canvas.width = w;
    this.canvas.height = h;
    this.canvas.getContext("2d").drawImage(this.video, 0, 0);
    this.canvas.toBlob((blob) => this.send(blob, w, h, time), "image/jpeg", 0.8);
  }

  async send(blob, w, h, time) {
    const jpeg = new Uint8Array(await blob.arrayBuffer());
    this.busy = false;
    if (!this.on || this.socket.readyState !== 1) return;
    const bytes = new Uint8Array(HEAD + jpeg.length);
    const view = new DataView(bytes.buffer);
    view.setUint8(0, 1);
    view.setUint16(4, w, true);
    view.setUint16(6, h, true);
    view.setFloat64(8, time, true);
    bytes.set(jpeg, HEAD);
    this.socket.send(bytes);
    this.state.sent++;
  }

  stop() {
    this.on = false;
    this.video.srcObject = null;
  }
}
