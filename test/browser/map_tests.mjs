// Maps: the track, the position at the cursor and its accuracy, the mouse, and the sources of tiles.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, dispatch, panelOf, colorOf, state } from "./studio_page.mjs";

const { main, mapped } = JSON.parse(process.argv[2]);
const S = 1e9;

async function openMap(page, base = main) {
  await open(page, base, "walk");
  const id = await panelOf(page, "Walker");
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i)?.layers.every((l) => l.track),
    "the tracks have arrived",
    id,
  );
  await settled(page);
  return id;
}

// Returns the position of a location on the canvas, and its color there.
const spot = (page, id, latitude, longitude) =>
  page.evaluate(
    ([i, lat, lon]) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const phi = (lat * Math.PI) / 180;
      const [wx, wy] = [(lon + 180) / 360, (1 - Math.asinh(Math.tan(phi)) / Math.PI) / 2];
      const [x, y] = [(wx - view.map.x) * view.map.px, (wy - view.map.y) * view.map.px];
      const k = devicePixelRatio;
      const d = view.canvas.getContext("2d").getImageData(Math.round(x * k), Math.round(y * k), 1, 1).data;
      return { x, y, color: [...d] };
    },
    [id, latitude, longitude],
  );

const alike = (seen, expected, what) =>
  ok(Math.hypot(...[0, 1, 2].map((k) => seen[k] - expected[k])) < 60, `${what}: expected ${expected}, got ${seen}`);

test("13 map: shows the past track, the future track, the position and its circle", async ({ page, shot }) => {
  const foreign = [];
  page.on("request", (r) => new URL(r.url()).origin !== new URL(main).origin && foreign.push(r.url()));
  const id = await openMap(page);
  await dispatch(page, { type: "cursor", t: 25 * S });
  await until(
    page,
    (i) => document.querySelector(`#${i} canvas`).dataset.at === String(25e9),
    "the position is shown",
    id,
  );
  await settled(page);
  await shot("map");
  const color = await colorOf(page, "Walker");
  const behind = await spot(page, id, 46.002, 14.5),
    here = await spot(page, id, 46.0045, 14.5),
    ahead = await spot(page, id, 46.007, 14.5);
  alike(behind.color, color, "the past track");
  alike(here.color, color, "where it is");
  // A grid line is below the track.
  const faint = Math.hypot(...[0, 1, 2].map((k) => ahead.color[k] - behind.color[k]));
  ok(faint > 60 && ahead.color[3] > 40, `the future track is faint: ${ahead.color}`);
  // With an accuracy of 50 m, checks a point inside the circle, one next to the track, and one outside the circle.
  const inside = await spot(page, id, 46.0045, 14.5 + 30 / 77300),
    outside = await spot(page, id, 46.0045, 14.5 + 75 / 77300);
  ok(inside.color[3] > 20 && outside.color[3] < 10, `a circle of 50 m: ${inside.color} ${outside.color}`);
  const text = await page.textContent(`#${id} .cell-info`);
  ok(/46\.004500, 14\.500000, ± 50 m/.test(text), `the text alternative: ${text}`);
  equal(foreign, [], "nothing is fetched from elsewhere");
});

test("13 map: the mouse shows position and time, a click goes there, the wheel zooms, keys move", async ({
  page,
}) => {
  const id = await openMap(page);
  const box = await page.locator(`#${id} canvas`).boundingBox();
  const at = await spot(page, id, 46.009, 14.5 + 0.5 * 0.0129);
  await page.mouse.move(box.x + at.x, box.y + at.y);
  await until(
    page,
    () => /Walker/.test(document.getElementById("tip")?.textContent ?? ""),
    "the mouse is on the track",
  );
  const tip = await page.textContent("#tip");
  ok(/00:01:15/.test(tip) && /46\.009000/.test(tip), `its time and position: ${tip}`);
  await page.mouse.down();
  await page.mouse.up();
  near((await state(page)).cursor, 75 * S, 1, "a click sets the cursor");
  const px = () => page.evaluate((i) => [...window.situStudio.views].find((v) => v.el.id === i).map.px, id);
  const before = await px();
  await page.mouse.wheel(0, -200);
  await until(
    page,
    ([i, b]) => [...window.situStudio.views].find((v) => v.el.id === i).map.px > b * 1.1,
    "the wheel zooms",
    [id, before],
  );
  const same = await spot(page, id, 46.009, 14.5 + 0.5 * 0.0129);
  near(same.x, at.x, 1, "it zooms around the mouse");
  await page.mouse.down();
  await page.mouse.move(box.x + at.x + 50, box.y + at.y + 20, { steps: 3 });
  await page.mouse.up();
  near((await spot(page, id, 46.009, 14.5 + 0.5 * 0.0129)).x, at.x + 50, 1, "dragging moves it");
  await page.locator(`#${id} canvas`).focus();
  await page.keyboard.press("0");
  near(await px(), before, 1, "0 shows everything again");
});

test("13 map: tiles are fetched from the user's source only", async ({ page, shot }) => {
  const id = await openMap(page, mapped);
  await until(
    page,
    (i) => {
      const { tiles } = [...window.situStudio.views].find((v) => v.el.id === i);
      const pictures = [...tiles.values()];
      return pictures.every((t) => t.complete) && pictures.some((t) => t.naturalWidth);
    },
    "every tile is loaded or missing",
    id,
  );
  await settled(page);
  await shot("map-tiles");
  const { color } = await spot(page, id, 46.0045, 14.5101);
  alike(color, [200, 60, 160], "the tile is below the track");
  const policy = (await page.goto(`${mapped}/s/walk`)).headers()["content-security-policy"];
  ok(/img-src 'self' blob: data:;/.test(policy), `the policy allows no source for a local folder: ${policy}`);
});
