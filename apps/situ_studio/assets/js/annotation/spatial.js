// Annotates images: boxes and points are drawn, dragged and resized on them. Each change is a key frame at the time
// of the shown image; positions between two key frames of a track are interpolated.

import { FONT, seriesColor, themeColors } from "../page/theme.js";
import {
  POSITION_FIELDS,
  boxBetween,
  dragPart,
  findGrip,
  listKeyFrames,
  positionAt,
  spatialKind,
} from "./key_frames.js";

const NEAR = 7,
  SMALL = 3;

export class Spatial {
  constructor(panel) {
    this.panel = panel;
    this.drag = null;
  }

  get kind() {
    return spatialKind(this.panel.state.attributes);
  }

  // Returns the timestamp of the shown image, which a shape drawn on it gets.
  imageTime(image) {
    return image.baseLayer()?.at ?? this.panel.app.time.get().cursor;
  }

  // Returns [track, {place, key}] for each shape on the image.
  listPositions(image) {
    const t = this.imageTime(image);
    return this.panel
      .trackNames()
      .map((track) => [track, positionAt(listKeyFrames(this.panel.state.items, track, this.kind), t)])
      .map(([track, at]) =>
        this.drag?.track === track ? [track, { place: this.drag.place, key: true }] : [track, at],
      )
      .filter(([, at]) => at);
  }

  // Returns the image that is annotated: the one drawn on last, or the first that is not a depth image.
  annotatedImage() {
    const pictures = [...this.panel.app.views].filter((v) => v.baseLayer);
    if (pictures.includes(this.image)) return this.image;
    return pictures.find((v) => v.layers.some((l) => l.vis.draw === "image")) ?? pictures[0];
  }

  draw(ctx, image) {
    if (!this.kind || this.annotatedImage() !== image) return;
    const map = image.map();
    ctx.font = FONT;
    ctx.textBaseline = "bottom";
    const all = this.listPositions(image);
    if (this.drag && !all.some(([track]) => track === this.drag.track))
      all.push([this.drag.track, { place: this.drag.place, key: true }]);
    for (const [track, { place, key }] of all) {
      const color = seriesColor(null, this.panel.trackNames().indexOf(track));
      ctx.strokeStyle = ctx.fillStyle = color;
      ctx.lineWidth = track === this.panel.track ? 3 : 1.5;
      // dashed between key frames, since the position is interpolated
      ctx.setLineDash(key ? [] : [6, 4]);
      const [x, y, w, h] = place;
      if (place.length === 2) {
        ctx.beginPath();
        ctx.arc(map.x(x), map.y(y), 5, 0, 2 * Math.PI);
        if (key) ctx.fill();
        else ctx.stroke();
      } else {
        const left = Math.min(map.x(x), map.x(x + w));
        ctx.strokeRect(left, map.y(y), w * map.k, h * map.k);
      }
      ctx.setLineDash([]);
      const left = place.length === 2 ? map.x(x) + 8 : Math.min(map.x(x), map.x(x + w));
      const { width } = ctx.measureText(track);
      ctx.fillStyle = themeColors().bg;
      ctx.fillRect(left, map.y(y) - 16, width + 6, 15);
      ctx.fillStyle = color;
      ctx.fillText(track, left + 3, map.y(y) - 2);
    }
    ctx.lineWidth = 1;
  }

  // Handles a press on an image; returns true if it was handled. With Ctrl or the middle button, the image is moved
  // as usual.
  handlePointerDown(e, image) {
    if (!this.kind || e.button !== 0 || e.ctrlKey || e.metaKey) return false;
    this.image = image;
    const toImage = (m) => image.map().back(...canvasPosition(m, image.canvas));
    const start = toImage(e);
    const { k, width, height } = image.fit();
    const found = this.listPositions(image)
      .map(([track, { place }]) => ({ track, place, part: findGrip(place, start, NEAR / k) }))
      .filter((f) => f.part !== null)
      .sort((a, b) => Number(b.track === this.panel.track) - Number(a.track === this.panel.track))[0];
    this.drag = found ? { ...found, from: start, old: found.place } : this.beginShape(image, start);
    this.panel.track = this.drag.track;
    const moveDrag = (m) => {
      const { old, part, from } = this.drag;
      this.drag.place =
        part === null
          ? boxBetween(from, toImage(m), width, height)
          : dragPart(old, part, from, toImage(m), width, height);
      this.drag.moved = true;
      this.panel.app.scheduleDraw(image);
    };
    const endDrag = () => {
      image.canvas.removeEventListener("pointermove", moveDrag);
      this.finishDrag(image, k);
    };
    image.canvas.setPointerCapture(e.pointerId);
    image.canvas.addEventListener("pointermove", moveDrag);
    image.canvas.addEventListener("pointerup", endDrag, { once: true });
    this.panel.app.scheduleDraw(this.panel);
    return true;
  }

  // Begins a new shape on the current track, or on the next free one if the image already has that track.
  beginShape(image, start) {
    const taken = new Set(this.listPositions(image).map(([track]) => track));
    let { track } = this.panel;
    for (let n = 1; taken.has(track); n++) track = String(n);
    const point = this.kind === "point";
    const place = point ? start : [...start, 0, 0];
    return { track, place, old: place, part: point ? "all" : null, from: start, moved: point };
  }

  finishDrag(image, k) {
    const { track, place, moved } = this.drag;
    this.drag = null;
    this.panel.app.scheduleDraw(image);
    // a click without a drag does not create a box
    if (!moved || (place.length === 4 && Math.max(place[2], place[3]) * k < SMALL)) return;
    this.pushKeyFrame(track, place, this.imageTime(image));
  }

  pushKeyFrame(track, place, t) {
    const values = Object.fromEntries(
      POSITION_FIELDS[this.kind].map((name, i) => [name, Math.round(place[i] * 100) / 100]),
    );
    this.panel.pushEdit("key_frame", {
      at: this.panel.app.client.toAbsolute(t),
      track,
      values,
      by: this.panel.annotator,
    });
  }
}

function canvasPosition(e, canvas) {
  const box = canvas.getBoundingClientRect();
  return [e.clientX - box.left, e.clientY - box.top];
}
