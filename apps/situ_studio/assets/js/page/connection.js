// Shows the state of the connection in the status line and, if the page cannot continue, in a banner.

const STATUS = {
  open: "connected",
  closed: "reconnecting",
  gone: "the recording is gone",
  broken: "unreadable reply",
};
const BANNER = {
  closed: "The studio's server is not responding. The page reconnects automatically.",
  gone: "This recording was deleted or moved. Data already loaded stays on the page.",
  broken: "The server's reply cannot be read. Reload the page.",
};
// Delay in ms before the page reports that the server is unreachable.
const LOST = 1500;
const MARK = "situ:lost",
  REMEMBERED = 5000;

export class Connection {
  // header writes into the page; toast(text) shows a brief message
  constructor(header, toast) {
    this.header = header;
    this.toast = toast;
    this.name = null;
  }

  // The live source has ended, although the connection still works. An empty text means that it has resumed.
  setEnded(text) {
    this.over = text;
    document.body.dataset.ended = text ? "1" : "";
    if (this.name === "open") this.header.setText("connection", text || STATUS.open);
  }

  setStatus(name) {
    if (name === this.name) return;
    this.name = name;
    document.body.dataset.connection = name;
    this.header.setText("connection", (name === "open" && this.over) || STATUS[name]);
    clearTimeout(this.timer);
    if (name === "closed") this.timer = setTimeout(() => this.announceStatus(), LOST);
    else this.announceStatus();
  }

  // Brief interruptions are not reported. A restarted server sends data first and then makes the page reload, so the
  // interruption is stored for a while and the new page reports it, too.
  announceStatus() {
    clearTimeout(this.forgetting);
    if (this.name === "closed") sessionStorage.setItem(MARK, "1");
    else if (this.name === "open" && sessionStorage.getItem(MARK)) {
      this.toast("Connected again");
      this.forgetting = setTimeout(() => sessionStorage.removeItem(MARK), REMEMBERED);
    }
    this.header.setText("banner", BANNER[this.name] ?? "");
  }
}
