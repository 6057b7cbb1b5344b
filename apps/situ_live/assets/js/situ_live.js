// The browser part of situ_live in addition to the stock clients: the hook that acknowledges diffs.

// The server sends one unrequested diff at a time and marks it with the event "situ:ack". The reply tells it that
// the page has applied the diff.
export const SituFlow = {
  mounted() {
    this.handleEvent("situ:ack", () => this.pushEvent("situ:ack", {}));
  },
};

// The `params` of the LiveSocket: this page acknowledges diffs.
export const connectParams = { situ_flow: "1" };
