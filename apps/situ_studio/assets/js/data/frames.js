// The headers, codes and flags of the binary frames. Generated from priv/frames.json by `npm run frames`.

export const FORMAT = { reply: 1 };

export const KIND = {
  series: 1,
  segments: 2,
  marks: 3,
  image: 4,
  json: 5,
  none: 6,
  same: 7,
  error: 8,
  pcm: 9,
  lines: 10,
  scene: 11,
  sounds: 12,
};

export const PIXELS = { jpeg: 1, png: 2, rgba: 3, gray8: 4, gray16: 5, rgb: 6, bgr: 7, bgra: 8 };

export const DEVICE = { camera: 1, microphone: 2, speaker: 3, headset: 4, drawing: 5 };

export const REPLY_FLAG = { live: 1, gone: 2, replaced: 4 };

export const FRAME_FLAG = { raw: 1, sampled: 2, together: 4 };

export const HEADSET_FLAG = {
  left: 1,
  right: 2,
  gaze: 4,
  planes: 8,
  left_selects: 16,
  right_selects: 32,
  selected: 64,
};

export const REPLY_BYTES = 40;

/** @param {DataView} view @param {number} at */
export function readReply(view, at) {
  return {
    format: view.getUint8(at),
    flags: view.getUint16(at + 2, true),
    request: view.getUint32(at + 4, true),
    from: view.getBigInt64(at + 8, true),
    to: view.getBigInt64(at + 16, true),
    count: view.getUint32(at + 24, true),
    version: view.getUint32(at + 28, true),
    time: view.getBigInt64(at + 32, true),
  };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readReply>} fields */
export function writeReply(view, at, fields) {
  view.setUint8(at, fields.format);
  view.setUint16(at + 2, fields.flags, true);
  view.setUint32(at + 4, fields.request, true);
  view.setBigInt64(at + 8, fields.from, true);
  view.setBigInt64(at + 16, fields.to, true);
  view.setUint32(at + 24, fields.count, true);
  view.setUint32(at + 28, fields.version, true);
  view.setBigInt64(at + 32, fields.time, true);
}

export const FRAME_BYTES = 32;

/** @param {DataView} view @param {number} at */
export function readFrame(view, at) {
  return {
    kind: view.getUint16(at, true),
    flags: view.getUint16(at + 2, true),
    channel: view.getUint32(at + 4, true),
    bytes: view.getUint32(at + 8, true),
    count: view.getUint32(at + 12, true),
    time: view.getBigInt64(at + 16, true),
    step: view.getBigInt64(at + 24, true),
  };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readFrame>} fields */
export function writeFrame(view, at, fields) {
  view.setUint16(at, fields.kind, true);
  view.setUint16(at + 2, fields.flags, true);
  view.setUint32(at + 4, fields.channel, true);
  view.setUint32(at + 8, fields.bytes, true);
  view.setUint32(at + 12, fields.count, true);
  view.setBigInt64(at + 16, fields.time, true);
  view.setBigInt64(at + 24, fields.step, true);
}

export const LINE_BYTES = 8;

/** @param {DataView} view @param {number} at */
export function readLine(view, at) {
  return { bytes: view.getUint32(at, true), count: view.getUint32(at + 4, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readLine>} fields */
export function writeLine(view, at, fields) {
  view.setUint32(at, fields.bytes, true);
  view.setUint32(at + 4, fields.count, true);
}

export const IMAGE_BYTES = 16;

/** @param {DataView} view @param {number} at */
export function readImage(view, at) {
  return {
    width: view.getUint32(at, true),
    height: view.getUint32(at + 4, true),
    pixels: view.getUint32(at + 8, true),
    unit: view.getUint32(at + 12, true),
  };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readImage>} fields */
export function writeImage(view, at, fields) {
  view.setUint32(at, fields.width, true);
  view.setUint32(at + 4, fields.height, true);
  view.setUint32(at + 8, fields.pixels, true);
  view.setUint32(at + 12, fields.unit, true);
}

export const SCENE_BYTES = 8;

/** @param {DataView} view @param {number} at */
export function readScene(view, at) {
  return { bytes: view.getUint32(at, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readScene>} fields */
export function writeScene(view, at, fields) {
  view.setUint32(at, fields.bytes, true);
}

export const CAMERA_BYTES = 16;

/** @param {DataView} view @param {number} at */
export function readCamera(view, at) {
  return {
    kind: view.getUint8(at),
    width: view.getUint16(at + 4, true),
    height: view.getUint16(at + 6, true),
    time: view.getFloat64(at + 8, true),
  };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readCamera>} fields */
export function writeCamera(view, at, fields) {
  view.setUint8(at, fields.kind);
  view.setUint16(at + 4, fields.width, true);
  view.setUint16(at + 6, fields.height, true);
  view.setFloat64(at + 8, fields.time, true);
}

export const MICROPHONE_BYTES = 16;

/** @param {DataView} view @param {number} at */
export function readMicrophone(view, at) {
  return { kind: view.getUint8(at), rate: view.getUint32(at + 4, true), time: view.getFloat64(at + 8, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readMicrophone>} fields */
export function writeMicrophone(view, at, fields) {
  view.setUint8(at, fields.kind);
  view.setUint32(at + 4, fields.rate, true);
  view.setFloat64(at + 8, fields.time, true);
}

export const SPEAKER_BYTES = 8;

/** @param {DataView} view @param {number} at */
export function readSpeaker(view, at) {
  return { kind: view.getUint8(at), rate: view.getUint32(at + 4, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readSpeaker>} fields */
export function writeSpeaker(view, at, fields) {
  view.setUint8(at, fields.kind);
  view.setUint32(at + 4, fields.rate, true);
}

export const HEADSET_BYTES = 16;

/** @param {DataView} view @param {number} at */
export function readHeadset(view, at) {
  return { kind: view.getUint8(at), flags: view.getUint8(at + 1), time: view.getFloat64(at + 8, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readHeadset>} fields */
export function writeHeadset(view, at, fields) {
  view.setUint8(at, fields.kind);
  view.setUint8(at + 1, fields.flags);
  view.setFloat64(at + 8, fields.time, true);
}

export const DRAWING_BYTES = 8;

/** @param {DataView} view @param {number} at */
export function readDrawing(view, at) {
  return { kind: view.getUint8(at), bytes: view.getUint32(at + 4, true) };
}

/** @param {DataView} view @param {number} at @param {ReturnType<typeof readDrawing>} fields */
export function writeDrawing(view, at, fields) {
  view.setUint8(at, fields.kind);
  view.setUint32(at + 4, fields.bytes, true);
}
