// Plug-ins: the guide's heat map over a picture, panels that a script fills, and scripts that are broken.
import { deflateRawSync } from "node:zlib";
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, dispatch, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

const layout = (panels) => {
  const doc = { version: 1, name: "", panels };
  return `?edit=${deflateRawSync(JSON.stringify(doc)).toString("base64url")}`;
};

// Adds a stream in a way, as the properties on the right do.
async function add(page, stream, viz) {
  await page.evaluate((s) => document.querySelector(`[data-stream="${s}"] .name`).click(), stream);
  await page.click(`.props button[phx-value-viz="${viz}"]`);
}

const infoOf = (page, viz) =>
  page.evaluate((v) => {
    for (const el of document.querySelectorAll("[phx-hook='Panel']"))
      if (JSON.parse(el.dataset.config).vis.some((x) => x.viz === v))
        return el.querySelector(".cell-info")?.textContent;
    return null;
  }, viz);

// The mean colour around a place of the picture.
const seen = (page, id, x, y) =>
  page.evaluate(
    ([i, px, py]) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const { map } = { map: view.map() };
      const k = devicePixelRatio;
      const ctx = view.canvas.getContext("2d");
      return [...ctx.getImageData(map.x(px) * k, map.y(py) * k, 1, 1).data].slice(0, 3);
    },
    [id, x, y],
  );

test("12 plugins: the guide's heat map is hot where somebody looked, at the cursor", async ({ page, shot }) => {
  await open(page, main, "gaze");
  await add(page, "Gaze.Point", "gaze-heat-map/heat");
  const id = await panelOf(page, "Camera.Image");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis.some((v) => v.viz === "gaze-heat-map/heat"),
    "it lies over the picture",
    id,
  );
  await dispatch(page, { type: "cursor", t: 4.9 * S });
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      return view.layers.some((l) => l.plug?.told?.rows?.length > 40);
    },
    "the past has come",
    id,
  );
  await settled(page);
  const [left, right] = [await seen(page, id, 84, 124), await seen(page, id, 244, 124)];
  ok(left[0] > left[2] + 60, `red where it was looked at: ${left}`);
  ok(Math.abs(right[0] - right[2]) < 12, `the picture as it is elsewhere: ${right}`);
  await dispatch(page, { type: "cursor", t: 9.9 * S });
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      return view.layers.some((l) => l.plug?.at >= 9.8e9);
    },
    "the new past has come",
    id,
  );
  await settled(page);
  const now = await seen(page, id, 244, 124);
  ok(now[0] > now[2] + 60, `the looks have moved to the right: ${now}`);
  await shot("plugin-heat");
  const box = await page.locator(`#${id} canvas`).boundingBox();
  const at = await page.evaluate((i) => {
    const map = [...window.situStudio.views].find((v) => v.el.id === i).map();
    return [map.x(244), map.y(124)];
  }, id);
  await page.mouse.move(box.x + at[0], box.y + at[1]);
  await until(
    page,
    () => /looked at: 100 %/.test(document.getElementById("tip")?.textContent ?? ""),
    "the mouse tells",
  );
  // its options are properties of the panel, and ask for another past
  await page.click(`#${id} >> xpath=ancestor::*[@data-panel][1] >> .title`);
  const field = "[id$='-2-seconds']";
  await page.fill(field, "1");
  await page.press(field, "Tab");
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const rows = view.layers.find((l) => l.plug)?.plug.told?.rows;
      return rows && rows.length <= 11;
    },
    "a second of looks is asked for",
    id,
  );
});

test("12 plugins: an adapter opens the heat map for angles", async ({ page }) => {
  await open(page, main, "gaze");
  await add(page, "Gaze.Angles", "gaze-heat-map/heat@gaze-angles");
  const id = await panelOf(page, "Camera.Image");
  await dispatch(page, { type: "cursor", t: 4 * S });
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const rows = view.layers.find((l) => l.plug)?.plug.told?.rows;
      return rows?.length > 30 && rows[0][1].type === "Situ.Point2";
    },
    "angles have come as places",
    id,
  );
  await settled(page);
  const left = await seen(page, id, 80, 124);
  ok(left[0] > left[2] + 60, `red where it was looked at: ${left}`);
});

test("12 plugins: a panel of its own has a canvas, elements, words for the mouse, options", async ({ page }) => {
  await open(page, main, "gaze");
  await add(page, "Gaze.Point", "counter/v");
  await dispatch(page, { type: "cursor", t: 2 * S });
  await until(page, () => document.querySelector(".own-body")?.textContent === "told 80", "it was told the message");
  await settled(page);
  const color = () =>
    page.evaluate(() => {
      const c = document.querySelector(".own-canvas");
      return [...c.getContext("2d").getImageData(10, 10, 1, 1).data];
    });
  equal(await color(), [0, 192, 96, 255], "it draws");
  const box = await page.locator(".own-canvas").boundingBox();
  await page.mouse.move(box.x + 20, box.y + 20);
  await until(page, () => document.getElementById("tip")?.textContent === "x is 80", "the mouse tells");
});

test("12 plugins: what is broken says so in its panel, and the rest goes on", async ({ page, shot }) => {
  const panels = ["throws", "unready", "syntax", "silent", "idle", "abroad", "counter"].map((id, i) => ({
    id: `p${i + 1}`,
    panel: "own",
    row: i < 4 ? "r1" : "r2",
    vis: [{ viz: `${id}/v`, stream: "Gaze.Point", path: "", props: {} }],
  }));
  panels.push({
    id: "p8",
    panel: "own",
    row: "r3",
    vis: [{ viz: "gone/v", stream: "Gaze.Point", path: "", props: {} }],
  });
  panels.push({
    id: "p9",
    panel: "image",
    row: "r3",
    vis: [{ viz: "image", stream: "Camera.Image", path: "", props: {} }],
  });
  await open(page, main, "gaze", layout(panels));
  await dispatch(page, { type: "cursor", t: 3 * S });
  for (const [id, words] of [
    ["throws", "draw failed: no paint"],
    ["unready", "open failed: not in the mood"],
    ["syntax", "cannot be loaded"],
    ["silent", "exports no open(host)"],
    ["idle", "open(host) gave nothing"],
    ["abroad", "cannot be loaded"],
  ]) {
    await until(
      page,
      ([v, w]) =>
        [...document.querySelectorAll("[phx-hook='Panel']")].some(
          (el) =>
            JSON.parse(el.dataset.config).vis.some((x) => x.viz === v) &&
            el.querySelector(".cell-info.bad")?.textContent.includes(w),
        ),
      `${id} says: ${words}`,
      [`${id}/v`, words],
    );
  }
  ok(
    (await infoOf(page, "gone/v")).includes("there is no visualizer"),
    `of one that is not there: ${await infoOf(page, "gone/v")}`,
  );
  await until(page, () => document.body.textContent.includes("told 80"), "the good one is told");
  equal(await infoOf(page, "counter/v"), "", "and says nothing bad");
  await shot("plugin-broken");
});

test("12 plugins: the list of recordings tells which plug-in is broken; only their folders are served", async ({
  page,
}) => {
  await page.goto(`${main}/`);
  ok((await page.textContent("[role=alert]")).includes("The plug-in torn is broken"), "it is told");
  const get = (path) => page.evaluate(async (p) => (await fetch(p)).status, path);
  equal(await get("/plugins/gaze-heat-map/heat.js"), 200, "a script");
  equal(await get("/plugins/gaze-heat-map/../plugin.json"), 404, "nothing above web/");
  equal(await get("/plugins/gaze-heat-map/%2e%2e/plugin.json"), 404, "nothing above web/");
  equal(await get("/plugins/nobody/x.js"), 404, "no other folder");
});
