// Measures the offset of this page's clock from the server's by round trips, of which the shortest is the most
// accurate (as in NTP).
const EVERY_MS = 2000;
const KEPT = 8;

export const now = () => performance.timeOrigin + performance.now();

export class Clock {
  constructor(socket, state) {
    this.socket = socket;
    this.state = state;
    this.trips = [];
    this.sendPing();
    this.timer = setInterval(() => this.sendPing(), EVERY_MS);
  }

  sendPing() {
    if (this.socket.readyState === 1) this.socket.send(JSON.stringify({ ping: now() }));
  }

  receivePong({ pong: sent, now: server }) {
    const got = now();
    this.trips = [...this.trips.slice(1 - KEPT), { ms: got - sent, offset: (sent + got) / 2 - server }];
    const best = this.trips.reduce((a, b) => (b.ms < a.ms ? b : a));
    this.state.offset = best.offset;
    this.state.trip = best.ms;
    this.socket.send(JSON.stringify({ offset: best.offset }));
    if (this.trips.length < KEPT) setTimeout(() => this.sendPing(), 50);
  }

  stop() {
    clearInterval(this.timer);
  }
}
