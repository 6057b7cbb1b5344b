// Plug-ins: the guide's heat map over an image, panels that a script draws, and broken scripts.
import { deflateRawSync } from "node:zlib";
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, dispatch, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

const layout = (panels) => {
  const doc = { version: 1, name: "", panels };
  return `?edit=${deflateRawSync(JSON.stringify(doc)).toString("base64url")}`;
};

// Adds a stream with a visualizer, as the properties on the right do.
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

// Returns the mean color around a position of the image.
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

test("12 plugins: the guide's heat map is hot where someone looked, at the cursor", async ({ page, shot }) => {
  await open(page, main, "gaze");
  await add(page, "Gaze.Point", "gaze-heat-map/heat");
  const id = await panelOf(page, "Camera.Image");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis.some((v) => v.viz === "gaze-heat-map/heat"),
    "it is on top of the image",
    id,
  );
  await dispatch(page, { type: "cursor", t: 4.9 * S });
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      return view.layers.some((l) => l.plug?.data?.rows?.length > 40);
    },
    "the history has arrived",
    id,
  );
  await settled(page);
  const [left, right] = [await seen(page, id, 84, 124), await seen(page, id, 244, 124)];
  ok(left[0] > left[2] + 60, `red where someone looked: ${left}`);
  ok(Math.abs(right[0] - right[2]) < 12, `the image is unchanged elsewhere: ${right}`);
  await dispatch(page, { type: "cursor", t: 9.9 * S });
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      return view.layers.some((l) => l.plug?.at >= 9.8e9);
    },
    "the new history has arrived",
    id,
  );
  await settled(page);
  const now = await seen(page, id, 244, 124);
  ok(now[0] > now[2] + 60, `the gaze has moved to the right: ${now}`);
  await shot("plugin-heat");
  const box = await page.locator(`#${id} canvas`).boundingBox();
  const at = await page.evaluate((i) => {
    const map = [...window.situStudio.views].find((v) => v.el.id === i).map();
    return [map.x(244), map.y(124)];
  }, id);
  await page.mouse.move(box.x + at[0], box.y + at[1]);
  await until(
    page,
    () => /heat: 100 %/.test(document.getElementById("tip")?.textContent ?? ""),
    "the tooltip is shown",
  );
  // Its options are properties of the panel, and change the required history.
  await page.click(`#${id} >> xpath=ancestor::*[@data-panel][1] >> .title`);
  const field = "[id$='-2-seconds']";
  await page.fill(field, "1");
  await page.press(field, "Tab");
  await until(
    page,
    (i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const rows = view.layers.find((l) => l.plug)?.plug.data?.rows;
      return rows && rows.length <= 11;
    },
    "one second of history is requested",
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
      const rows = view.layers.find((l) => l.plug)?.plug.data?.rows;
      return rows?.length > 30 && rows[0][1].type === "Situ.Point2";
    },
    "angles arrive as positions",
    id,
  );
  await settled(page);
  const left = await seen(page, id, 80, 124);
  ok(left[0] > left[2] + 60, `red where someone looked: ${left}`);
});

test("12 plugins: a panel draws a canvas and elements, and has mouse texts and options", async ({ page }) => {
  await open(page, main, "gaze");
  await add(page, "Gaze.Point", "counter/v");
  await dispatch(page, { type: "cursor", t: 2 * S });
  await until(
    page,
    () => document.querySelector(".own-body")?.textContent === "told 80",
    "the script receives the message",
  );
  await settled(page);
  const color = () =>
    page.evaluate(() => {
      const c = document.querySelector(".own-canvas");
      return [...c.getContext("2d").getImageData(10, 10, 1, 1).data];
    });
  equal(await color(), [0, 192, 96, 255], "it draws");
  const box = await page.locator(".own-canvas").boundingBox();
  await page.mouse.move(box.x + 20, box.y + 20);
  await until(page, () => document.getElementById("tip")?.textContent === "x is 80", "the tooltip is shown");
});

test("12 plugins: broken scripts are reported in their panels, and the rest continues", async ({ page, shot }) => {
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
    ["silent", "does not export open(host)"],
    ["idle", "open(host) did not return"],
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
    `a missing script is reported: ${await infoOf(page, "gone/v")}`,
  );
  await until(page, () => document.body.textContent.includes("told 80"), "the working script receives messages");
  equal(await infoOf(page, "counter/v"), "", "it shows no error");
  await shot("plugin-broken");
});

test("12 plugins: the list of recordings shows broken plug-ins; only their folders are served", async ({ page }) => {
  await page.goto(`${main}/`);
  ok(
    (await page.textContent("[role=alert]")).includes("The plug-in torn is broken"),
    "the broken plug-in is reported",
  );
  const get = (path) => page.evaluate(async (p) => (await fetch(p)).status, path);
  equal(await get("/plugins/gaze-heat-map/heat.js"), 200, "a script");
  equal(await get("/plugins/gaze-heat-map/../plugin.json"), 404, "nothing above web/");
  equal(await get("/plugins/gaze-heat-map/%2e%2e/plugin.json"), 404, "nothing above web/");
  equal(await get("/plugins/nobody/x.js"), 404, "no other folder");
});
