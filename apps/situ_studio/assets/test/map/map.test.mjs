import test from "node:test";
import assert from "node:assert/strict";
import * as m from "../../js/map/mercator.js";
import { nearest, until, way } from "../../js/map/track.js";

const near = (a, b, by) => assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);

test("the square: its middle, its edges, there and back", () => {
  assert.equal(m.toX(0), 0.5);
  near(m.toY(0), 0.5, 1e-12);
  near(m.toY(m.EDGE), 0, 1e-12);
  near(m.toY(-90), 1, 1e-9);
  for (const [lat, lon] of [
    [46.0514, 14.506],
    [-33.9, 151.2],
    [0, -179.99],
    [84.9, 3],
  ]) {
    near(m.toLatitude(m.toY(lat)), lat, 1e-9);
    near(m.toLongitude(m.toX(lon)), lon, 1e-9);
  }
});

// By the formula of OpenStreetMap's wiki, "Slippy map tilenames".
test("tiles have the numbers that everybody gives them", () => {
  const n = 2 ** 17;
  assert.equal(Math.floor(m.toX(13.37771496) * n), 70406);
  assert.equal(Math.floor(m.toY(52.51628219) * n), 42987);
  const map = { px: 256 * 4, x: m.toX(14.5) - 0.1, y: m.toY(46) - 0.1 };
  const found = m.tiles(map, 300, 200);
  assert.ok(found.length >= 2 && found.every((t) => t.z === 2 && t.size === 256));
  assert.ok(found.some((t) => t.left <= 0 && t.top <= 0));
  assert.ok(m.tiles({ px: 256, x: -0.6, y: 0 }, 400, 256).every((t) => t.x >= 0 && t.x < 1));
});

test("a metre and a scale", () => {
  near(m.perMetre(0) * 40075016.69, 1, 1e-6);
  near(m.perMetre(60) / m.perMetre(0), 2, 1e-9);
  near(m.distance([46, 14], [46, 15]), 77300, 200);
  assert.deepEqual(m.scale(120, 1), { metres: 100, px: 100 });
  assert.equal(m.scale(120, 0.5).metres, 50);
});

test("a way passes the line of dates without going round the world", () => {
  const column = (last) => ({ count: last.length, t: last.map((_, i) => i * 10), last });
  const track = way(column([10, 10, 10]), column([179.5, -179.5, 179.8]), 5);
  near(track.x[1] - track.x[0], 1 / 360, 1e-12);
  near(track.x[2] - track.x[1], -0.7 / 360, 1e-9);
  assert.deepEqual([...track.t], [5, 15, 25]);
  assert.deepEqual(
    [4, 5, 14, 15, 99].map((t) => until(track, t)),
    [0, 1, 1, 2, 3],
  );
  assert.equal(nearest(track, track.x[1], track.y[1] + 1e-6, 1e-5), 1);
  assert.equal(nearest(track, 0.2, 0.2, 1e-5), -1);
});
