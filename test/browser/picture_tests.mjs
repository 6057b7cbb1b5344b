// Panels at the cursor: images with overlays, depth, bars and values.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, dispatch, pixel, count, colorOf, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;
const color = (s) => [(s * 4) % 256, 255 - ((s * 4) % 256), (s * 40) % 256];

test("4 pictures: the image at the cursor is shown with its rectangles", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Camera.Image");
  for (const s of [10, 33, 50]) {
    await dispatch(page, { type: "cursor", t: s * S + 3e8 });
    await until(
      page,
      ([i, at]) => document.querySelector(`#${i} canvas`).dataset.at === String(at),
      `the image of second ${s} is shown`,
      [id, s * S],
    );
    await settled(page);
    const [r, g, b] = await pixel(page, `#${id} canvas`, 0.75, 0.5);
    equal([r, g, b], color(s), `colour of second ${s}`);
  }
  ok((await count(page, `#${id} canvas`, [0x4e, 0xa1, 0xf3], 12)) > 100, "the rectangle and its label are drawn");
  await shot("pictures");
});

test("4 a film: image and waveform of an MP4 follow the cursor back and forth", async ({ page, shot }) => {
  await open(page, main, "film.mp4");
  const id = await panelOf(page, "Video"),
    wave = await panelOf(page, "Audio");
  const times = [];
  for (const s of [7, 2, 1, 8, 4]) {
    const asked = Date.now();
    await dispatch(page, { type: "cursor", t: s * S + 5e8 });
    // A frame is shown from its own time on. There are 25 per second, 12 of them in half a second.
    await until(
      page,
      ([i, at]) => document.querySelector(`#${i} canvas`).dataset.at === String(at),
      `the image of second ${s} is shown`,
      [id, s * S + 48e7],
    );
    times.push(Date.now() - asked);
    await settled(page);
    const seen = await pixel(page, `#${id} canvas`, 0.75, 0.5);
    color(s).forEach((c, i) => near(seen[i], c, 12, `channel ${i} of second ${s}`));
  }
  console.log(`film: cursor to picture ${times.join(", ")} ms`);
  const heights = await page.evaluate((i) => {
    const points = [...window.situStudio.views].find((v) => v.el.id === i).layers[0].channel.series;
    return [points.length > 100, points.raw];
  }, wave);
  equal(heights, [true, false], "the waveform is folded");
  ok((await count(page, `#${wave} canvas`, await colorOf(page, "Audio"))) > 3000, "the waveform has a body");
  await shot("film");
});

test("4 depth, bars and values are shown at the cursor", async ({ page }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "cursor", t: 30 * S });
  await settled(page);
  const depth = await panelOf(page, "Kinect.Depth");
  const left = await pixel(page, `#${depth} canvas`, 0.3, 0.5),
    right = await pixel(page, `#${depth} canvas`, 0.7, 0.5);
  ok(left[0] > left[2] && right[2] > right[0], `near is warm, far is cold: ${left} ${right}`);
  await page.hover(`#${depth} canvas`);
  await until(
    page,
    (i) => /= \d+/.test(document.querySelector(`#${i} .cell-info`).textContent),
    "the depth under the mouse is shown",
    depth,
  );
  await page.click("#tree .node[data-stream='Speech.Scores'] .name");
  await page.click("button[phx-value-viz='bars']");
  await until(page, () => document.querySelector(".chart-cell"), "bars are shown");
  await settled(page);
  const bars = await page.evaluate(() => document.querySelector(".chart-cell").id);
  ok((await count(page, `#${bars} canvas`, await colorOf(page, "Speech.Scores"))) > 2000, "bars are drawn");
  await page.click("#tree .node[data-stream='Camera.Faces'] .name");
  await page.click("button[phx-value-viz='value']");
  await until(
    page,
    () => [...document.querySelectorAll(".value-tree .v")].some((e) => e.textContent === '"Ada"'),
    "the value tree shows the label",
  );
});

test("4 values: a path is plotted from the menu", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node >> nth=0");
  await until(
    page,
    () => [...document.querySelectorAll(".value-tree .k")].some((e) => e.textContent === "pose"),
    "the value is shown as a tree",
  );
  const row = page.locator(".value-tree .row", { has: page.locator(".k", { hasText: /^x$/ }) });
  await row.hover();
  await row.locator(".plot-path").click();
  await until(
    page,
    () =>
      [...window.situStudio.views].some((v) =>
        v.layers?.some((l) => l.vis.path === ".pose.x" && l.channel.series.length === 60),
      ),
    "the path is plotted",
  );
  const low = await page.$eval("[data-panel].selected", (e) => e.getBoundingClientRect().bottom);
  ok(low <= 700, `the new panel is in sight: it ends at ${low}`);
  await settled(page);
  await shot("values");
});

test("4 values: the tree is navigated and plotted with keys alone", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node >> nth=0");
  await until(
    page,
    () => [...document.querySelectorAll(".value-tree .k")].some((e) => e.textContent === "pose"),
    "the value is shown as a tree",
  );
  await page.focus(".value-tree");
  await page.keyboard.press("ArrowDown");
  const rows = () => page.$$eval(".value-tree .row", (r) => r.length);
  const all = await rows();
  await page.keyboard.press("ArrowLeft");
  await until(page, () => document.querySelectorAll(".value-tree .row").length === 1, "the root is folded");
  await page.keyboard.press("ArrowRight");
  await until(page, (n) => document.querySelectorAll(".value-tree .row").length === n, "unfolded again", all);
  for (
    let i = 0;
    i < all && (await page.evaluate(() => document.activeElement.querySelector(".k")?.textContent)) !== "x";
    i++
  )
    await page.keyboard.press("ArrowDown");
  await page.keyboard.press("Enter");
  await until(
    page,
    () => [...window.situStudio.views].some((v) => v.layers?.some((l) => l.vis.path === ".pose.x")),
    "the path is plotted",
  );
});

test("4 depth: the color range is fixed, and missing readings have their own color", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Kinect.Depth");
  await page.click("button.title[title='Kinect.Depth']");
  const at = (s) => dispatch(page, { type: "cursor", t: s * S });
  await at(0);
  await settled(page);
  const own = await pixel(page, `#${id} canvas`, 0.5, 0.4);
  await page.selectOption("#f-p2-0-range", "fixed");
  await until(page, () => document.querySelector("#f-p2-0-min"), "the ends of the range can be set");
  await page.fill("#f-p2-0-min", "100");
  await page.fill("#f-p2-0-max", "900");
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i).layers[0].picture.range.join() === "100,900",
    "the displayed image is colored again",
    id,
  );
  await settled(page);
  const fixed = await pixel(page, `#${id} canvas`, 0.5, 0.4);
  ok(fixed[2] > fixed[0] && own[2] < fixed[2], `900 is the far end now: ${own} -> ${fixed}`);
  await shot("depth-range");
  // The depth at (0, 0) in second 0 is 500.
  await page.fill("#f-p2-0-invalid", "500");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis[0].props.invalid === 500,
    "the value of missing readings is set",
    id,
  );
  await page.$eval("#f-p2-0-invalid_color", (e) => {
    e.value = "#ff00ff";
    e.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis[0].props.invalid_color === "#ff00ff",
    "the colour is set",
    id,
  );
  await settled(page);
  const magenta = () => count(page, `#${id} canvas`, [255, 0, 255], 12);
  ok((await magenta()) > 10, "missing readings are magenta");
  await page.click("button[title='Back to see-through']");
  await until(
    page,
    (i) => !JSON.parse(document.getElementById(i).dataset.config).vis[0].props.invalid_color,
    "the color is reset",
    id,
  );
  await settled(page);
  equal(await magenta(), 0, "missing readings are transparent again");
});

test("4 pictures: values under the mouse are shown, also in mirrored images", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Camera.Image");
  await dispatch(page, { type: "cursor", t: 10 * S });
  await settled(page);
  // Returns the position on the screen of a pixel of the 64 x 48 image.
  const point = async (x, y) => {
    const box = await page.$eval(`#${id}`, (e) => {
      const b = e.getBoundingClientRect();
      return [b.left, b.top, b.width, b.height];
    });
    const k = Math.min(box[2] / 64, box[3] / 48);
    await page.mouse.move(box[0] + (box[2] - 64 * k) / 2 + x * k, box[1] + (box[3] - 48 * k) / 2 + y * k);
  };
  const told = () =>
    page.evaluate(() => {
      const t = document.getElementById("tip");
      return t && !t.hidden ? t.textContent : "";
    });
  await point(15, 15);
  await until(page, () => document.getElementById("tip")?.textContent.includes("Ada"), "the tooltip shows the face");
  equal(
    (await told()).split("\n"),
    ["Ada", "score 0.93", "id 0", "20 × 20 at (10, 10)"],
    "label, score, id and position",
  );
  await shot("hover");
  await point(45, 40);
  await until(page, () => document.getElementById("tip").hidden, "no tooltip without an object");
  await page.click(`button.title[title='Camera.Image, Camera.Faces']`);
  await page.check("#f-p1-0-flip");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis[0].props.flip === true,
    "mirrored",
    id,
  );
  await settled(page);
  await point(64 - 15, 15);
  await until(page, () => !document.getElementById("tip").hidden, "the face is on the other side");
  await page.mouse.move(5, 5);
  await until(page, () => document.getElementById("tip").hidden, "the tooltip disappears with the mouse");
});
