// Whether the server answers, told in the status line and, where the page cannot go on, in words that are seen.

const STATUS = {
  open: "connected",
  closed: "reconnecting",
  gone: "the recording is gone",
  broken: "unreadable answer",
};
const BANNER = {
  closed: "The studio's server does not answer. The page goes on by itself as soon as it does.",
  gone: "This recording was deleted or moved. Everything read of it before stays on the page.",
  broken: "The server's answer cannot be read: reload the page.",
};
// How long the server may be away before the page says so, in ms.
const LOST = 1500;
const MARK = "situ:lost",
  REMEMBERED = 5000;

export class Connection {
  // header: what writes into the page; toast(text): what says something in passing
  constructor(header, toast) {
    Object.assign(this, { header, toast, name: null });
  }

  // The live stream is no more; the connection still stands. An empty text: it goes on.
  ended(text) {
    this.over = text;
    document.body.dataset.ended = text ? "1" : "";
    if (this.name === "open") this.header.set("connection", text || STATUS.open);
  }

  set(name) {
    if (name === this.name) return;
    this.name = name;
    document.body.dataset.connection = name;
    this.header.set("connection", (name === "open" && this.over) || STATUS[name]);
    clearTimeout(this.timer);
    if (name === "closed") this.timer = setTimeout(() => this.say(), LOST);
    else this.say();
  }

  // A moment without the server is not worth a word. One that was started again answers for data first, and then has
  // the page loaded again: that it was lost is remembered for a while, so that the new page says it, too.
  say() {
    clearTimeout(this.forgetting);
    if (this.name === "closed") sessionStorage.setItem(MARK, "1");
    else if (this.name === "open" && sessionStorage.getItem(MARK)) {
      this.toast("Connected again");
      this.forgetting = setTimeout(() => sessionStorage.removeItem(MARK), REMEMBERED);
    }
    this.header.set("banner", BANNER[this.name] ?? "");
  }
}
