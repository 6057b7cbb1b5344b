// How far this page's clock is ahead of the server's: round trips, of which the shortest tells most (as NTP does).
const EVERY_MS = 2000;
const KEPT = 8;

export const now = () => performance.timeOrigin + performance.now();

export class Clock {
  constructor(socket, state) {
    this.socket = socket;
    this.state = state;
    this.trips = [];
    this.ping();
    this.timer = setInterval(() => this.ping(), EVERY_MS);
  }

  ping() {
    if (this.socket.readyState === 1) this.socket.send(JSON.stringify({ ping: now() }));
  }

  pong({ pong: sent, now: server }) {
    const got = now();
    this.trips = [...this.trips.slice(1 - KEPT), { ms: got - sent, offset: (sent + got) / 2 - server }];
    const best = this.trips.reduce((a, b) => (b.ms < a.ms ? b : a));
    this.state.offset = best.offset;
    this.state.trip = best.ms;
    this.socket.send(JSON.stringify({ offset: best.offset }));
    if (this.trips.length < KEPT) setTimeout(() => this.ping(), 50);
  }

  stop() {
    clearInterval(this.timer);
  }
}
