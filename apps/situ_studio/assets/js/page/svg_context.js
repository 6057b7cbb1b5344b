// Draws a panel as SVG: implements the used part of a canvas context and writes elements. svgcanvas (2.6.0, 1,700
// lines) does not fit: it does not scale line widths, clearing paints white, only canvases can be drawn as images,
// and it applies the screen's pixel ratio.

import { getContext2d } from "./dom.js";

const roundCoordinate = (x) => Math.round(x * 100) / 100;

const escapeXml = (text) =>
  String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);

const ANCHOR = { right: "end", end: "end", center: "middle" };

// The properties that `save` and `restore` keep.
const SAVED = /** @type {const} */ ([
  ...["fillStyle", "strokeStyle", "lineWidth", "lineJoin", "globalAlpha", "font", "textAlign", "textBaseline"],
  ...["imageSmoothingEnabled", "dash", "matrix", "clipped"],
]);

export class SvgContext {
  // measure: a real context, which measures texts
  constructor(width, height, measure) {
    this.width = width;
    this.height = height;
    this.measure = measure;
    this.fillStyle = "#000";
    this.strokeStyle = "#000";
    this.lineWidth = 1;
    this.lineJoin = "miter";
    this.globalAlpha = 1;
    this.font = "10px sans-serif";
    this.textAlign = "left";
    this.textBaseline = "alphabetic";
    this.imageSmoothingEnabled = true;
    this.dash = [];
    this.matrix = [1, 0, 0, 1, 0, 0];
    this.stack = [];
    this.parts = [];
    this.defs = [];
    this.path = [];
    /** @type {string | null} */
    this.clipped = null;
  }

  save() {
    this.stack.push(Object.fromEntries(SAVED.map((name) => [name, this[name]])));
  }

  restore() {
    Object.assign(this, this.stack.pop());
  }

  // Ignores the screen's pixel ratio: SVG uses pixels of the page.
  setTransform() {
    this.matrix = [1, 0, 0, 1, 0, 0];
  }

  translate(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    this.matrix = [a, b, c, d, e + a * x + c * y, f + b * x + d * y];
  }

  scale(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    this.matrix = [a * x, b * x, c * y, d * y, e, f];
  }

  rotate(angle) {
    const [a, b, c, d, e, f] = this.matrix;
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    this.matrix = [a * cos + c * sin, b * cos + d * sin, c * cos - a * sin, d * cos - b * sin, e, f];
  }

  transformPoint(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return `${roundCoordinate(a * x + c * y + e)} ${roundCoordinate(b * x + d * y + f)}`;
  }

  clearRect() {}

  beginPath() {
    this.path = [];
  }

  closePath() {
    this.path.push("Z");
  }

  moveTo(x, y) {
    this.path.push(`M${this.transformPoint(x, y)}`);
  }

  lineTo(x, y) {
    this.path.push(`${this.path.length ? "L" : "M"}${this.transformPoint(x, y)}`);
  }

  rect(x, y, w, h) {
    this.moveTo(x, y);
    this.lineTo(x + w, y);
    this.lineTo(x + w, y + h);
    this.lineTo(x, y + h);
    this.closePath();
  }

  roundRect(x, y, w, h, radius) {
    const r = Math.max(Math.min(radius, w / 2, h / 2), 0);
    const addCorner = (cx, cy, ex, ey) =>
      this.path.push(`Q${this.transformPoint(cx, cy)} ${this.transformPoint(ex, ey)}`);
    this.moveTo(x + r, y);
    this.lineTo(x + w - r, y);
    addCorner(x + w, y, x + w, y + r);
    this.lineTo(x + w, y + h - r);
    addCorner(x + w, y + h, x + w - r, y + h);
    this.lineTo(x + r, y + h);
    addCorner(x, y + h, x, y + h - r);
    this.lineTo(x, y + r);
    addCorner(x, y, x + r, y);
    this.closePath();
  }

  // Adds a full circle, the only arc that panels draw.
  arc(x, y, r) {
    const k = r * Math.abs(this.matrix[0]);
    this.path.push(`M${this.transformPoint(x - r, y)}`);
    for (const to of [x + r, x - r])
      this.path.push(`A${roundCoordinate(k)} ${roundCoordinate(k)} 0 1 1 ${this.transformPoint(to, y)}`);
  }

  clip() {
    const id = `clip${this.defs.length}`;
    const within = this.clipped ? ` clip-path="url(#${this.clipped})"` : "";
    this.defs.push(`<clipPath id="${id}"><path${within} d="${this.path.join("")}"/></clipPath>`);
    this.clipped = id;
  }

  addElement(element, attributes, content) {
    const all = { ...attributes, opacity: this.globalAlpha === 1 ? null : roundCoordinate(this.globalAlpha) };
    if (this.clipped) all["clip-path"] = `url(#${this.clipped})`;
    const text = Object.entries(all)
      .filter(([, v]) => v != null)
      .map(([k, v]) => ` ${k}="${escapeXml(v)}"`)
      .join("");
    this.parts.push(
      content === undefined ? `<${element}${text}/>` : `<${element}${text}>${escapeXml(content)}</${element}>`,
    );
  }

  fill() {
    if (this.path.length) this.addElement("path", { d: this.path.join(""), fill: this.fillStyle });
  }

  stroke() {
    if (!this.path.length) return;
    this.addElement("path", {
      d: this.path.join(""),
      fill: "none",
      stroke: this.strokeStyle,
      "stroke-width": roundCoordinate(this.lineWidth * Math.abs(this.matrix[3])),
      "stroke-linejoin": this.lineJoin,
      "stroke-dasharray": this.dash.length ? this.dash.join(" ") : null,
    });
  }

  drawRect(x, y, w, h, draw) {
    const before = this.path;
    this.path = [];
    this.rect(x, y, w, h);
    draw.call(this);
    this.path = before;
  }

  fillRect(x, y, w, h) {
    this.drawRect(x, y, w, h, this.fill);
  }

  strokeRect(x, y, w, h) {
    this.drawRect(x, y, w, h, this.stroke);
  }

  setLineDash(dash) {
    this.dash = dash;
  }

  measureText(text) {
    this.measure.font = this.font;
    return this.measure.measureText(text);
  }

  fillText(text, x, y) {
    const [left, top] = this.transformPoint(x, y).split(" ");
    const [a, b] = this.matrix;
    const turned = roundCoordinate((Math.atan2(b, a) * 180) / Math.PI);
    const [, size, family] = /([\d.]+)px\s+(.*)/.exec(this.font) ?? [null, "11", "sans-serif"];
    this.addElement(
      "text",
      {
        x: left,
        y: top,
        transform: turned && a >= 0 ? `rotate(${turned} ${left} ${top})` : null,
        fill: this.fillStyle,
        "font-size": size,
        "font-family": family,
        "text-anchor": ANCHOR[this.textAlign],
        "dominant-baseline": this.textBaseline === "middle" ? "central" : null,
      },
      text,
    );
  }

  // Embeds an image as PNG.
  drawImage(image, x, y, w = image.width, h = image.height) {
    const canvas = document.createElement("canvas");
    // a decoded image of a video has other names for its size
    [canvas.width, canvas.height] = [image.displayWidth ?? image.width, image.displayHeight ?? image.height];
    getContext2d(canvas).drawImage(image, 0, 0);
    const [left, top] = this.transformPoint(x, y).split(" ");
    const [k, , , l] = this.matrix;
    this.addElement("image", {
      x: left,
      y: top,
      width: roundCoordinate(Math.abs(w * k)),
      height: roundCoordinate(Math.abs(h * l)),
      preserveAspectRatio: "none",
      href: canvas.toDataURL("image/png"),
    });
  }

  // Returns the text of the SVG file; `title` is for screen readers.
  toSvg(background, title) {
    const [width, height] = [roundCoordinate(this.width), roundCoordinate(this.height)];
    return [
      `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}"`,
      ` viewBox="0 0 ${width} ${height}" role="img">\n<title>${escapeXml(title)}</title>\n`,
      this.defs.length ? `<defs>${this.defs.join("")}</defs>\n` : "",
      `<rect width="100%" height="100%" fill="${escapeXml(background)}"/>\n`,
      this.parts.join("\n"),
      "\n</svg>\n",
    ].join("");
  }
}
