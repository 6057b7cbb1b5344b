import test from "node:test";
import assert from "node:assert/strict";
import * as m from "../../js/map/mercator.js";
import { nearestPoint, countUntil, buildTrack } from "../../js/map/track.js";

const assertNear = (a, b, by) => assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);

test("positions convert to the square and back", () => {
  assert.equal(m.toX(0), 0.5);
  assertNear(m.toY(0), 0.5, 1e-12);
  assertNear(m.toY(m.EDGE), 0, 1e-12);
  assertNear(m.toY(-90), 1, 1e-9);
  for (const [lat, lon] of [
    [46.0514, 14.506],
    [-33.9, 151.2],
    [0, -179.99],
    [84.9, 3],
  ]) {
    assertNear(m.toLatitude(m.toY(lat)), lat, 1e-9);
    assertNear(m.toLongitude(m.toX(lon)), lon, 1e-9);
  }
});

// Expected values by the formula of OpenStreetMap's wiki, "Slippy map tilenames".
test("tiles have the standard numbers", () => {
  const n = 2 ** 17;
  assert.equal(Math.floor(m.toX(13.37771496) * n), 70406);
  assert.equal(Math.floor(m.toY(52.51628219) * n), 42987);
  const map = { px: 256 * 4, x: m.toX(14.5) - 0.1, y: m.toY(46) - 0.1 };
  const found = m.visibleTiles(map, 300, 200);
  assert.ok(found.length >= 2 && found.every((t) => t.z === 2 && t.size === 256));
  assert.ok(found.some((t) => t.left <= 0 && t.top <= 0));
  assert.ok(m.visibleTiles({ px: 256, x: -0.6, y: 0 }, 400, 256).every((t) => t.x >= 0 && t.x < 1));
});

test("meters convert to units, and scales are round", () => {
  assertNear(m.unitsPerMetre(0) * 40075016.69, 1, 1e-6);
  assertNear(m.unitsPerMetre(60) / m.unitsPerMetre(0), 2, 1e-9);
  assertNear(m.groundDistance([46, 14], [46, 15]), 77300, 200);
  assert.deepEqual(m.roundScale(120, 1), { metres: 100, px: 100 });
  assert.equal(m.roundScale(120, 0.5).metres, 50);
});

test("a track crosses the date line without circling the world", () => {
  const buildColumn = (last) => ({ count: last.length, t: last.map((_, i) => i * 10), last });
  const track = buildTrack(buildColumn([10, 10, 10]), buildColumn([179.5, -179.5, 179.8]), 5);
  assertNear(track.x[1] - track.x[0], 1 / 360, 1e-12);
  assertNear(track.x[2] - track.x[1], -0.7 / 360, 1e-9);
  assert.deepEqual([...track.t], [5, 15, 25]);
  assert.deepEqual(
    [4, 5, 14, 15, 99].map((t) => countUntil(track, t)),
    [0, 1, 1, 2, 3],
  );
  assert.equal(nearestPoint(track, track.x[1], track.y[1] + 1e-6, 1e-5), 1);
  assert.equal(nearestPoint(track, 0.2, 0.2, 1e-5), -1);
});
