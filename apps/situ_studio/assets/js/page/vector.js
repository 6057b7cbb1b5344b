// The drawing of a panel as SVG: the part of a canvas' context that they use, writing elements down. Not svgcanvas
// (2.6.0, 1,700 lines): there lines keep their width when the drawing is scaled, clearing paints white, pictures other
// than canvases are left out, and the screen's own scale counts.

const round = (x) => Math.round(x * 100) / 100;

const escape = (text) =>
  String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);

const ANCHOR = { right: "end", end: "end", center: "middle" };

const DEFAULTS = {
  fillStyle: "#000",
  strokeStyle: "#000",
  lineWidth: 1,
  lineJoin: "miter",
  globalAlpha: 1,
  font: "10px sans-serif",
  textAlign: "left",
  textBaseline: "alphabetic",
  imageSmoothingEnabled: true,
};

export class Vector {
  // measure: a real context, which knows how wide texts are
  constructor(width, height, measure) {
    Object.assign(this, DEFAULTS, { width, height, measure });
    this.dash = [];
    this.matrix = [1, 0, 0, 1, 0, 0];
    this.stack = [];
    this.parts = [];
    this.defs = [];
    this.path = [];
    this.clipped = null;
  }

  save() {
    const own = Object.fromEntries(Object.keys(DEFAULTS).map((k) => [k, this[k]]));
    this.stack.push({ ...own, dash: this.dash, matrix: this.matrix, clipped: this.clipped });
  }

  restore() {
    Object.assign(this, this.stack.pop());
  }

  // Whatever the screen's pixels are, a vector's are those of the page.
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

  point(x, y) {
    const [a, b, c, d, e, f] = this.matrix;
    return `${round(a * x + c * y + e)} ${round(b * x + d * y + f)}`;
  }

  clearRect() {}

  beginPath() {
    this.path = [];
  }

  closePath() {
    this.path.push("Z");
  }

  moveTo(x, y) {
    this.path.push(`M${this.point(x, y)}`);
  }

  lineTo(x, y) {
    this.path.push(`${this.path.length ? "L" : "M"}${this.point(x, y)}`);
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
    const corner = (cx, cy, ex, ey) => this.path.push(`Q${this.point(cx, cy)} ${this.point(ex, ey)}`);
    this.moveTo(x + r, y);
    this.lineTo(x + w - r, y);
    corner(x + w, y, x + w, y + r);
    this.lineTo(x + w, y + h - r);
    corner(x + w, y + h, x + w - r, y + h);
    this.lineTo(x + r, y + h);
    corner(x, y + h, x, y + h - r);
    this.lineTo(x, y + r);
    corner(x, y, x + r, y);
    this.closePath();
  }

  // Only whole circles are drawn: points, of lines and over pictures.
  arc(x, y, r) {
    const k = r * Math.abs(this.matrix[0]);
    this.path.push(`M${this.point(x - r, y)}`);
    for (const to of [x + r, x - r]) this.path.push(`A${round(k)} ${round(k)} 0 1 1 ${this.point(to, y)}`);
  }

  clip() {
    const id = `clip${this.defs.length}`;
    const within = this.clipped ? ` clip-path="url(#${this.clipped})"` : "";
    this.defs.push(`<clipPath id="${id}"><path${within} d="${this.path.join("")}"/></clipPath>`);
    this.clipped = id;
  }

  put(element, attributes, content) {
    const all = { ...attributes, opacity: this.globalAlpha === 1 ? null : round(this.globalAlpha) };
    if (this.clipped) all["clip-path"] = `url(#${this.clipped})`;
    const text = Object.entries(all)
      .filter(([, v]) => v != null)
      .map(([k, v]) => ` ${k}="${escape(v)}"`)
      .join("");
    this.parts.push(
      content === undefined ? `<${element}${text}/>` : `<${element}${text}>${escape(content)}</${element}>`,
    );
  }

  fill() {
    if (this.path.length) this.put("path", { d: this.path.join(""), fill: this.fillStyle });
  }

  stroke() {
    if (!this.path.length) return;
    this.put("path", {
      d: this.path.join(""),
      fill: "none",
      stroke: this.strokeStyle,
      "stroke-width": round(this.lineWidth * Math.abs(this.matrix[3])),
      "stroke-linejoin": this.lineJoin,
      "stroke-dasharray": this.dash.length ? this.dash.join(" ") : null,
    });
  }

  drawn(x, y, w, h, draw) {
    const before = this.path;
    this.path = [];
    this.rect(x, y, w, h);
    draw.call(this);
    this.path = before;
  }

  fillRect(x, y, w, h) {
    this.drawn(x, y, w, h, this.fill);
  }

  strokeRect(x, y, w, h) {
    this.drawn(x, y, w, h, this.stroke);
  }

  setLineDash(dash) {
    this.dash = dash;
  }

  measureText(text) {
    this.measure.font = this.font;
    return this.measure.measureText(text);
  }

  fillText(text, x, y) {
    const [left, top] = this.point(x, y).split(" ");
    const [a, b] = this.matrix;
    const turned = round((Math.atan2(b, a) * 180) / Math.PI);
    const [, size, family] = /([\d.]+)px\s+(.*)/.exec(this.font) ?? [null, "11", "sans-serif"];
    this.put(
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

  // Pictures stay pictures: as PNG, in their place.
  drawImage(image, x, y, w = image.width, h = image.height) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.getContext("2d").drawImage(image, 0, 0);
    const [left, top] = this.point(x, y).split(" ");
    const [k, , , l] = this.matrix;
    this.put("image", {
      x: left,
      y: top,
      width: round(Math.abs(w * k)),
      height: round(Math.abs(h * l)),
      preserveAspectRatio: "none",
      href: canvas.toDataURL("image/png"),
    });
  }

  // The file's text; `title` names it for those who cannot see it.
  text(background, title) {
    return [
      `<svg xmlns="http://www.w3.org/2000/svg" width="${round(this.width)}" height="${round(this.height)}"`,
      ` viewBox="0 0 ${round(this.width)} ${round(this.height)}" role="img">\n<title>${escape(title)}</title>\n`,
      this.defs.length ? `<defs>${this.defs.join("")}</defs>\n` : "",
      `<rect width="100%" height="100%" fill="${escape(background)}"/>\n`,
      this.parts.join("\n"),
      "\n</svg>\n",
    ].join("");
  }
}
