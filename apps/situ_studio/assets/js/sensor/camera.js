// Sends camera images as JPEG when the pipeline has credit for one; other images are not encoded.
import { CAMERA_BYTES, DEVICE, writeCamera } from "../data/frames.js";
import { now } from "../device/clock.js";
import { getContext2d } from "../page/dom.js";

export class Camera {
  constructor(stream, video, socket, state) {
    this.video = video;
    this.socket = socket;
    this.state = state;
    this.room = 0;
    this.busy = false;
    this.on = true;
    this.canvas = document.createElement("canvas");
    video.srcObject = new MediaStream(stream.getVideoTracks());
    video.play().catch(() => {}); // stopped before it began
    this.requestFrame();
  }

  addCredit(n) {
    this.room += n;
  }

  requestFrame() {
    const takeFrame = (_, frame) => {
      if (!this.on) return;
      this.captureImage(frame?.captureTime ? performance.timeOrigin + frame.captureTime : now());
      this.requestFrame();
    };
    if (this.video.requestVideoFrameCallback) this.video.requestVideoFrameCallback(takeFrame);
    else setTimeout(takeFrame, 33);
  }

  captureImage(time) {
    const { videoWidth: w, videoHeight: h } = this.video;
    if (!w) return;
    if (this.room < 1 || this.busy || this.state.offset === null) return void this.state.dropped++;
    this.room--;
    this.busy = true;
    this.canvas.width = w;
    this.canvas.height = h;
    getContext2d(this.canvas).drawImage(this.video, 0, 0);
    this.canvas.toBlob((blob) => this.sendImage(blob, w, h, time), "image/jpeg", 0.8);
  }

  async sendImage(blob, w, h, time) {
    const jpeg = new Uint8Array(await blob.arrayBuffer());
    this.busy = false;
    if (!this.on || this.socket.readyState !== 1) return;
    const bytes = new Uint8Array(CAMERA_BYTES + jpeg.length);
    writeCamera(new DataView(bytes.buffer), 0, { kind: DEVICE.camera, width: w, height: h, time });
    bytes.set(jpeg, CAMERA_BYTES);
    this.socket.send(bytes);
    this.state.sent++;
  }

  stop() {
    this.on = false;
    this.video.srcObject = null;
  }
}
