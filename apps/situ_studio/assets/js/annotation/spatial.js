// Annotating on pictures: boxes and points are drawn, dragged and resized there. Each change is a key frame at the
// time of the picture that is shown; between two key frames of a track the place is interpolated.

import { FONT, seriesColor, theme } from "../page/theme.js";
import { PLACES, boxOf, dragged, grip, keyFrames, placeAt, spatialKind } from "./key_frames.js";

const NEAR = 7,
  SMALL = 3;

export class Spatial {
  constructor(panel) {
    this.panel = panel;
    this.drag = null;
  }

  get kind() {
    return spatialKind(this.panel.told.attributes);
  }

  // A shape drawn on a picture gets the picture's own time.
  time(image) {
    return image.base()?.at ?? this.panel.app.time.get().cursor;
  }

  // [track, {place, key}] of all that is on the picture.
  places(image) {
    const t = this.time(image);
    return this.panel
      .tracks()
      .map((track) => [track, placeAt(keyFrames(this.panel.told.items, track, this.kind), t)])
      .map(([track, at]) =>
        this.drag?.track === track ? [track, { place: this.drag.place, key: true }] : [track, at],
      )
      .filter(([, at]) => at);
  }

  // One picture is annotated: the one that was drawn on last, else the first that is no depth.
  picture() {
    const pictures = [...this.panel.app.views].filter((v) => v.base);
    if (pictures.includes(this.image)) return this.image;
    return pictures.find((v) => v.layers.some((l) => l.vis.draw === "image")) ?? pictures[0];
  }

  draw(ctx, image) {
    if (!this.kind || this.picture() !== image) return;
    const map = image.map();
    ctx.font = FONT;
    ctx.textBaseline = "bottom";
    const all = this.places(image);
    if (this.drag && !all.some(([track]) => track === this.drag.track))
      all.push([this.drag.track, { place: this.drag.place, key: true }]);
    for (const [track, { place, key }] of all) {
      const color = seriesColor(null, this.panel.tracks().indexOf(track));
      ctx.strokeStyle = ctx.fillStyle = color;
      ctx.lineWidth = track === this.panel.track ? 3 : 1.5;
      // between key frames it is a guess
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
      ctx.fillStyle = theme().bg;
      ctx.fillRect(left, map.y(y) - 16, width + 6, 15);
      ctx.fillStyle = color;
      ctx.fillText(track, left + 3, map.y(y) - 2);
    }
    ctx.lineWidth = 1;
  }

  // A press on a picture: true when it is ours. With Ctrl or the middle button the picture is moved as ever.
  down(e, image) {
    if (!this.kind || e.button !== 0 || e.ctrlKey || e.metaKey) return false;
    this.image = image;
    const at = (m) => image.map().back(...position(m, image.canvas));
    const start = at(e);
    const { k, width, height } = image.fit();
    const found = this.places(image)
      .map(([track, { place }]) => ({ track, place, part: grip(place, start, NEAR / k) }))
      .filter((f) => f.part !== null)
      .sort((a, b) => (b.track === this.panel.track) - (a.track === this.panel.track))[0];
    this.drag = found ? { ...found, from: start, old: found.place } : this.begun(image, start);
    this.panel.track = this.drag.track;
    const move = (m) => {
      const { old, part, from } = this.drag;
      this.drag.place =
        part === null ? boxOf(from, at(m), width, height) : dragged(old, part, from, at(m), width, height);
      this.drag.moved = true;
      this.panel.app.schedule(image);
    };
    const up = () => {
      image.canvas.removeEventListener("pointermove", move);
      this.settle(image, k);
    };
    image.canvas.setPointerCapture(e.pointerId);
    image.canvas.addEventListener("pointermove", move);
    image.canvas.addEventListener("pointerup", up, { once: true });
    this.panel.app.schedule(this.panel);
    return true;
  }

  // Something new: on the chosen track, or on the next free one where that is on the picture already.
  begun(image, start) {
    const taken = new Set(this.places(image).map(([track]) => track));
    let { track } = this.panel;
    for (let n = 1; taken.has(track); n++) track = String(n);
    const point = this.kind === "point";
    const place = point ? start : [...start, 0, 0];
    return { track, place, old: place, part: point ? "all" : null, from: start, moved: point };
  }

  settle(image, k) {
    const { track, place, moved } = this.drag;
    this.drag = null;
    this.panel.app.schedule(image);
    // a click is no box
    if (!moved || (place.length === 4 && Math.max(place[2], place[3]) * k < SMALL)) return;
    this.key(track, place, this.time(image));
  }

  key(track, place, t) {
    const values = Object.fromEntries(PLACES[this.kind].map((name, i) => [name, Math.round(place[i] * 100) / 100]));
    this.panel.push("key_frame", { at: this.panel.app.client.abs(t), track, values, by: this.panel.annotator });
  }
}

function position(e, canvas) {
  const box = canvas.getBoundingClientRect();
  return [e.clientX - box.left, e.clientY - box.top];
}
