// The page of the browser test: the stock clients, our hooks, and counters that the test reads.
import { Socket } from "phoenix";
import { LiveSocket } from "phoenix_live_view";
import { SituFlow, connectParams, domCallbacks } from "../js/situ_live.js";

const seen = (window.seen = { points: [], ticks: 0, ticked: 0, mounted: 0, reconnected: 0, acks: 0 });

const Canvas = {
  mounted() {
    seen.mounted++;
    window.hook = this;
    this.handleEvent("points", ({ pts }) => seen.points.push(pts));
    this.handleEvent("tick", () => seen.ticks++);
    this.handleEvent("ticked", () => seen.ticked++);
    this.handleEvent("situ:ack", () => seen.acks++);
  },
  reconnected() {
    seen.reconnected++;
  },
};

const liveSocket = new LiveSocket("/live", Socket, {
  params: connectParams,
  dom: domCallbacks,
  hooks: { Canvas, SituFlow },
});
liveSocket.connect();
window.liveSocket = liveSocket;
