// The browser's half of situ_live beside the stock clients: the hook that acknowledges diffs.

// The server sends one diff at a time by itself. It marks each with the event "situ:ack"; answering it tells that
// the page has taken the diff in.
export const SituFlow = {
  mounted() {
    this.handleEvent("situ:ack", () => this.pushEvent("situ:ack", {}));
  },
};

// The `params` of the LiveSocket: that this page acknowledges.
export const connectParams = { situ_flow: "1" };
