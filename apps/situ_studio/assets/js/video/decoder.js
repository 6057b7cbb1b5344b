// Decoders with the same interface: video by WebCodecs, and images that do not depend on each other (JPEG, PNG).
//
// start() begins anew, feed() takes a packet, drain() and ready() wait, flush() returns everything. An image arrives at
// `accept(number, image, bytes)`, which takes it over; number is -1 for an image that is not shown.

// The number of packets that wait in the decoder.
const QUEUE = 16;

/**
 * @typedef {object} Config
 * @property {string} codec
 * @property {Uint8Array} description
 * @property {number} rotation
 * @property {number} [width] the size of the images in pixels; they may be compressed with one more column or row
 * @property {number} [height]
 * @property {boolean} colorStated whether the stream states its color matrix
 * @property {(number: number, image: any, bytes: number) => void} accept
 * @property {(reason: string) => void} fail
 */

// Returns a decoder, or the reason why this browser has none.
/** @param {Config} config */
export async function openDecoder(config) {
  if (config.codec === "jpeg" || config.codec === "png") return { decoder: new StillDecoder(config) };
  if (typeof VideoDecoder === "undefined")
    return {
      reason: isSecureContext
        ? "this browser has no WebCodecs"
        : "browsers decode video only on pages from localhost or over HTTPS (bin/situ studio --tls)",
    };
  const found = await findSupport(config);
  return found
    ? { decoder: new SequenceDecoder(config, found) }
    : { reason: `this browser does not decode ${config.codec}` };
}

// Browsers assume BT.709 for many streams that state no colors. FFmpeg assumes BT.601, so images from the server would
// have other colors.
/** @type {VideoColorSpaceInit} */
const UNSTATED_COLOR = { matrix: "smpte170m", primaries: "bt709", transfer: "iec61966-2-1", fullRange: false };

// Decoded images are held for some time. The frames of a hardware decoder are few, so the software decoder is used.
/** @param {Config} config */
async function findSupport({ codec, description, colorStated }) {
  const described = {
    codec,
    ...(description.length && { description }),
    ...(!colorStated && { colorSpace: UNSTATED_COLOR }),
  };
  for (const hardwareAcceleration of /** @type {const} */ (["prefer-software", "no-preference"])) {
    const config = { ...described, hardwareAcceleration };
    try {
      if ((await VideoDecoder.isConfigSupported(config)).supported) return config;
    } catch {
      // a codec that the browser cannot even parse
    }
  }
  return null;
}

export class SequenceDecoder {
  /**
   * @param {Config} options
   * @param {VideoDecoderConfig} config
   */
  constructor({ rotation, width, height, accept, fail }, config) {
    this.config = config;
    this.size = [width ?? 0, height ?? 0];
    this.rotation = rotation;
    this.accept = accept;
    // a decoder that is closed keeps quiet
    this.closed = false;
    this.waiting = [];
    this.decoder = new VideoDecoder({
      output: (frame) => this.takeFrame(frame),
      error: (error) => {
        if (!this.closed) fail(error.message);
        this.wake();
      },
    });
    this.decoder.addEventListener("dequeue", () => this.wake());
  }

  start() {
    if (this.decoder.state === "configured") this.decoder.reset();
    this.decoder.configure(this.config);
  }

  feed(bytes, key, number) {
    const timestamp = number < 0 ? -1 : number;
    this.decoder.decode(new EncodedVideoChunk({ type: key ? "key" : "delta", timestamp, data: bytes }));
  }

  // Resolves when the decoder can take another packet.
  async ready() {
    while (this.decoder.state === "configured" && this.decoder.decodeQueueSize >= QUEUE) await this.progress();
  }

  // Resolves when the decoder has returned an image, or has taken all packets.
  async drain() {
    if (this.decoder.state === "configured" && this.decoder.decodeQueueSize > 0) await this.progress();
  }

  progress() {
    return new Promise((resolve) => {
      // for browsers without the event "dequeue"
      const timer = setTimeout(() => this.wake(), 20);
      this.waiting.push(() => {
        clearTimeout(timer);
        resolve(null);
      });
    });
  }

  async flush() {
    await this.decoder.flush().catch(() => {});
  }

  wake() {
    for (const resolve of this.waiting.splice(0)) resolve();
  }

  takeFrame(frame) {
    this.wake();
    if (this.closed || frame.timestamp < 0) return frame.close();
    frame = cropFrame(frame, this.size);
    if (!this.rotation) return this.accept(frame.timestamp, frame, frame.codedWidth * frame.codedHeight * 1.5);
    const image = rotateImage(frame, this.rotation);
    this.accept(frame.timestamp, image, image.width * image.height * 4);
    frame.close();
  }

  close() {
    this.closed = true;
    this.wake();
    if (this.decoder.state !== "closed") this.decoder.close();
  }
}

// Removes the column and the row that make the size of a compressed image even.
/**
 * @param {VideoFrame} frame
 * @param {number[]} size
 */
export function cropFrame(frame, [width, height]) {
  const { displayWidth, displayHeight } = frame;
  const [extraWidth, extraHeight] = [displayWidth - width, displayHeight - height];
  const padded = (extra, size) => extra === 1 && size % 2 === 1;
  const columns = padded(extraWidth, width),
    rows = padded(extraHeight, height);
  if (!columns && !rows) return frame;
  const visibleRect = { x: 0, y: 0, width: displayWidth - Number(columns), height: displayHeight - Number(rows) };
  const { width: w, height: h } = visibleRect;
  const cropped = new VideoFrame(frame, { visibleRect, displayWidth: w, displayHeight: h });
  frame.close();
  return cropped;
}

// Turns an image clockwise by a multiple of 90 degrees.
function rotateImage(frame, degrees) {
  const { displayWidth: w, displayHeight: h } = frame;
  const across = degrees % 180 !== 0;
  const canvas = new OffscreenCanvas(across ? h : w, across ? w : h);
  const ctx = canvas.getContext("2d");
  if (!ctx) throw new Error("the browser has no memory for another canvas");
  ctx.translate(canvas.width / 2, canvas.height / 2);
  ctx.rotate((degrees * Math.PI) / 180);
  ctx.drawImage(frame, -w / 2, -h / 2);
  return canvas.transferToImageBitmap();
}

export class StillDecoder {
  /** @param {Config} options */
  constructor({ codec, accept, fail }) {
    this.type = `image/${codec}`;
    this.accept = accept;
    this.fail = fail;
    this.closed = false;
    this.running = new Set();
  }

  start() {}

  feed(bytes, _key, number) {
    const work = this.decode(bytes, number).finally(() => this.running.delete(work));
    this.running.add(work);
  }

  async decode(bytes, number) {
    try {
      const image = await createImageBitmap(new Blob([bytes], { type: this.type }));
      if (this.closed) image.close();
      else this.accept(number, image, image.width * image.height * 4);
    } catch (error) {
      if (!this.closed) this.fail(error.message);
    }
  }

  async drain() {
    if (this.running.size) await Promise.race(this.running);
  }

  async ready() {
    while (this.running.size >= 2) await Promise.race(this.running);
  }

  async flush() {
    await Promise.all(this.running);
  }

  close() {
    this.closed = true;
  }
}
