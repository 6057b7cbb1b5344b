// 3D panels: every primitive at its position and in its color, the viewer's tools, and broken items.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, dispatch, colorOf, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;
// The position of the nth item of the fixture.
const place = (n) => [(n % 4) * 3, Math.floor(n / 4) * 3, 0];

async function openSpace(page, source, stream, query = "") {
  await open(page, main, source, query);
  const id = await panelOf(page, stream);
  await until(
    page,
    (i) => window.situStudio && [...window.situStudio.views].find((v) => v.el.id === i)?.stage,
    "the 3D code is loaded",
    id,
  );
  await settled(page);
  return id;
}

// Calls a function with the panel's view and an argument, in the page.
const view = (page, id, run, arg) =>
  page.evaluate(
    ([i, code, a]) => {
      const panel = [...window.situStudio.views].find((v) => v.el.id === i);
      return new Function("view", "arg", `return (${code})(view, arg)`)(panel, a);
    },
    [id, run.toString(), arg],
  );

// Looks from above at a position from close by, and returns its color (the mean of a few pixels around it).
async function colorAt(page, id, [x, y, z], { from = [-0.01, 0, 4], span = 2 } = {}) {
  return view(
    page,
    id,
    (v, { at, eye, r }) => {
      const { stage, canvas } = v;
      stage.view.lookFrom([at[0] + eye[0], at[1] + eye[1], at[2] + eye[2]], at);
      v.render();
      const [px, py] = stage.projectPosition(...at).map((c) => Math.round(c * devicePixelRatio));
      const d = canvas.getContext("2d").getImageData(px - r, py - r, 2 * r + 1, 2 * r + 1).data;
      const sum = [0, 0, 0];
      for (let i = 0; i < d.length; i += 4) [0, 1, 2].forEach((k) => (sum[k] += d[i + k]));
      return sum.map((s) => (4 * s) / d.length);
    },
    { at: [x, y, z], eye: from, r: span },
  );
}

// Light changes the brightness of a body, but not which of red, green and blue is strongest.
function alike(seen, expected, what, least = 0.97) {
  const norm = (v) => Math.hypot(...v) || 1;
  const cos = seen.reduce((s, v, k) => s + v * expected[k], 0) / norm(seen) / norm(expected);
  ok(norm(seen) > 60 && cos > least, `${what}: expected something like ${expected}, got ${seen.map(Math.round)}`);
}

test("11 space: nine primitives have their positions and colors", async ({ page, shot }) => {
  const id = await openSpace(page, "space.0000", "A.Points");
  const config = await page.evaluate((i) => JSON.parse(document.getElementById(i).dataset.config), id);
  equal(config.vis.length, 9, "all streams share one panel");
  await shot("space");
  const color = (stream) => colorOf(page, stream);
  alike(await colorAt(page, id, place(0)), [250, 30, 200], "points have their own colours");
  alike(
    await colorAt(
      page,
      id,
      place(1).map((c, k) => c + [0, 0, 0.2][k]),
      { span: 0, from: [-0.01, 0, 1] },
    ),
    await color("B.Arrows"),
    "an arrow",
    0.9,
  );
  alike(await colorAt(page, id, [6.5, 0, 0.5], { span: 0 }), await color("C.Box"), "a box's edge", 0.9);
  alike(await colorAt(page, id, place(3)), await color("D.Mesh"), "a mesh", 0.95);
  // A text is a little above its position on the screen.
  const text = await view(
    page,
    id,
    (v, at) => {
      v.stage.view.lookFrom([at[0] - 0.01, at[1], 4], at);
      v.render();
      const [x, y] = v.stage.projectPosition(...at);
      const k = devicePixelRatio;
      return [...v.canvas.getContext("2d").getImageData((x - 26) * k, (y - 14) * k, 1, 1).data];
    },
    place(4),
  );
  alike(text.slice(0, 3), await color("E.Text"), "a text's label");
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i).stage.memory().textures >= 1,
    "the image is uploaded",
    id,
  );
  await settled(page);
  const left = await colorAt(page, id, [3, 3.25, 0.3]),
    right = await colorAt(page, id, [3, 2.75, 0.3]);
  ok(
    Math.abs(left[1] - right[1]) > 80 && Math.abs(left[2] - right[2]) > 80,
    `an image has two halves: ${left} ${right}`,
  );
  alike(
    await colorAt(page, id, [6, 3, 0.3], { span: 3, from: [-0.01, 0, 1.2] }),
    [138, 146, 156],
    "a camera's apex",
    0.9,
  );
  alike(await colorAt(page, id, [9, 3, 1], { span: 0, from: [-0.01, 0, 0.6] }), await color("H.Body"), "a head", 0.9);
  const low = await colorAt(page, id, [-0.5, 5.5, 0.2]),
    high = await colorAt(page, id, [0.3, 6.3, 0.2]);
  ok(low[2] > low[0] && high[0] > high[2], `voxels by value, low is cold and high is warm: ${low} ${high}`);
});

test("11 space: drawings follow the cursor, and the mouse shows the item under it", async ({ page }) => {
  const id = await openSpace(page, "space.0000", "H.Body");
  const seen = () => colorAt(page, id, [9.5, 3, 1], { span: 0, from: [-0.01, 0, 0.6] });
  await dispatch(page, { type: "cursor", t: 0 });
  await settled(page);
  const before = await seen();
  await dispatch(page, { type: "cursor", t: 10 * S });
  await until(
    page,
    ([i, t]) => document.querySelector(`#${i} canvas`).dataset.at === String(t),
    "the last message is drawn",
    [id, 10 * S],
  );
  await settled(page);
  const after = await seen();
  ok(Math.hypot(...after.map((c, k) => c - before[k])) > 40, `the body has come: ${before} ${after}`);
  const box = await page.locator(`#${id} canvas`).boundingBox();
  const [x, y] = await view(page, id, (v) => v.stage.projectPosition(9.5, 3, 1));
  await page.mouse.move(box.x + x, box.y + y);
  await until(
    page,
    () => document.getElementById("tip")?.textContent.includes("head"),
    "the tooltip names the joint",
  );
  const tip = await page.textContent("#tip");
  ok(
    /H\.Body/.test(tip) && /body 3 head/.test(tip) && /\(9\.\d+, .*\) m/.test(tip),
    `stream, thing and place: ${tip}`,
  );
});

test("11 space: turn, fly, view from above, follow, measure", async ({ page }) => {
  const id = await openSpace(page, "space.0000", "D.Mesh");
  const eye = () => view(page, id, (v) => v.stage.view.camera.position.toArray());
  const box = await page.locator(`#${id} canvas`).boundingBox();
  const start = await eye();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 120, box.y + box.height / 2 + 20, { steps: 4 });
  await page.mouse.up();
  const turned = await eye();
  ok(Math.hypot(...turned.map((c, k) => c - start[k])) > 0.5, "dragging turns around");
  await page.click(`#${id} [data-tool=top]`);
  const [ex, ey, ez] = await eye();
  const target = await view(page, id, (v) => v.stage.view.orbit.target.toArray());
  ok(Math.abs(ex - target[0]) < 0.1 && Math.abs(ey - target[1]) < 0.1 && ez > target[2], "from above");
  await page.click(`#${id} [data-tool=fly]`);
  equal(await page.getAttribute(`#${id} [data-tool=fly]`, "aria-pressed"), "true", "flying is on");
  const before = await eye();
  await page.keyboard.down("w");
  await until(
    page,
    ([i, z]) => [...window.situStudio.views].find((v) => v.el.id === i).stage.view.camera.position.z < z - 0.05,
    "w flies ahead: down, from above",
    [id, before[2]],
  );
  await page.keyboard.up("w");
  await page.click(`#${id} [data-tool=fly]`);
  await view(page, id, (v) => {
    v.stage.view.lookFrom([8.99, 0, 4], [9, 0, 0.1]);
    v.render();
  });
  await page.click(`#${id} [data-tool=measure]`);
  for (const y of [-0.4, 0.4]) {
    const [px, py] = await view(page, id, (v, left) => v.stage.projectPosition(9, left, 0.1), y);
    await page.mouse.click(box.x + px, box.y + py);
  }
  const length = await view(page, id, (v) => v.stage.measured[0].distanceTo(v.stage.measured[1]));
  near(length, 0.8, 0.03, "measured on the mesh");
  // The view follows the body when it walks.
  await page.click(`#${id} [data-tool=measure]`);
  await dispatch(page, { type: "cursor", t: 0 });
  await settled(page);
  await view(page, id, (v) => v.stage.view.lookFrom([8.99, 3, 2.2], [9, 3, 1]));
  await settled(page);
  const [hx, hy] = await view(page, id, (v) => v.stage.projectPosition(9, 3, 1.01));
  await page.mouse.click(box.x + hx, box.y + hy);
  await page.click(`#${id} [data-tool=follow]`);
  const was = await eye();
  await dispatch(page, { type: "cursor", t: 10 * S });
  await until(
    page,
    ([i, x]) => [...window.situStudio.views].find((v) => v.el.id === i).stage.view.camera.position.x > x + 0.4,
    "the view walks along",
    [id, was[0]],
  );
});

test("11 space: properties set color, thickness and trail, and hide a layer", async ({ page }) => {
  const id = await openSpace(page, "space.0000", "A.Points");
  await page.click(`#${id} >> xpath=ancestor::*[@data-panel][1] >> .title`);
  const field = (key, index) => `[id$='-${index}-${key}']`;
  await page.selectOption(field("color_by", 0), "one");
  await until(
    page,
    () =>
      window.situStudio &&
      JSON.stringify([...document.querySelectorAll("[phx-hook='Panel']")].map((e) => e.dataset.config)).includes(
        "color_by",
      ),
    "the property is shown",
  );
  await settled(page);
  alike(await colorAt(page, id, place(0)), await colorOf(page, "A.Points"), "one colour");
  await page.uncheck(field("visible", 0));
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i).layers[0].vis.props.visible === false,
    "it is off",
    id,
  );
  await settled(page);
  const off = await colorAt(page, id, [0.2, 0.25, 0]);
  ok(Math.max(...off) < 60, `nothing is left of it: ${off}`);
});

test("11 space: broken items are reported, and the rest is drawn", async ({ page, shot }) => {
  const id = await openSpace(page, "space-broken", "A.Holes");
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).classList.contains("bad"),
    "the panel says that something is wrong",
    id,
  );
  const text = await view(page, id, (v) =>
    JSON.stringify(v.layers.map((l) => [l.vis.stream, l.error, l.failure, l.frame?.problems])),
  );
  for (const [stream, words] of [
    ["A.Holes", "1 of 6 points are invalid"],
    ["B.Empty", "an empty cloud"],
    ["C.Torn", "whole number of points"],
    ["D.Mesh", "triangle 0 refers to vertex 900 of 3"],
    ["E.Body", "1 edges refer to missing nodes"],
    ["F.Nowhere", "1 of 1 nodes are invalid"],
    ["G.View", "bytes"],
  ])
    ok(
      JSON.parse(text).some((l) => l[0] === stream && JSON.stringify(l).includes(words)),
      `${stream}: ${words}: ${text}`,
    );
  alike(await colorAt(page, id, [0.2, 0.2, 0]), await colorOf(page, "H.Good"), "the good mesh is drawn", 0.95);
  const nobody = JSON.parse(text).find((l) => l[0] === "I.Nobody");
  equal(nobody, ["I.Nobody", null, null, []], "a list of nobody is no fault");
  const close = { span: 0, from: [-0.01, 0, 0.6] };
  alike(await colorAt(page, id, [0.5, 3, 0], close), await colorOf(page, "J.Line"), "a line", 0.9);
  const [low, high] = [await colorAt(page, id, [0, 6, 0], close), await colorAt(page, id, [1, 6, 0], close)];
  ok(low[2] > low[0] && high[0] > high[2], `points by their values, low is cold and high is warm: ${low} ${high}`);
  await shot("space-broken");
});

test("11 space: frames of reference position the items in them", async ({ page, shot }) => {
  const id = await openSpace(page, "space-frames", "Light", "");
  await dispatch(page, { type: "cursor", t: 6 * S });
  await settled(page);
  await page.click(`#${id} >> xpath=ancestor::*[@data-panel][1] >> .title`);
  const light = await page.evaluate(
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis.findIndex((v) => v.stream === "Light"),
    id,
  );
  const field = `[id$='-${light}-frame']`;
  await page.fill(field, "lamp");
  await page.press(field, "Tab");
  await until(
    page,
    ([i, k]) => [...window.situStudio.views].find((v) => v.el.id === i).layers[k].vis.props.frame === "lamp",
    "the frame is set",
    [id, light],
  );
  await settled(page);
  // At second 6 the robot is at 3 m, and the lamp is 1 m above it.
  alike(
    await colorAt(page, id, [3, 0, 1], { span: 0, from: [-0.3, 0.1, 0] }),
    await colorOf(page, "Light"),
    "the light hangs in the lamp's frame",
    0.9,
  );
  await shot("space-frames");
  await page.fill(field, "moon");
  await page.press(field, "Tab");
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).textContent.includes('no frame "moon"'),
    "a missing frame is reported",
    id,
  );
});

test("11 space: a limited number of points is drawn, and the limit is shown", async ({ page }) => {
  const id = await openSpace(page, "space-big", "Cloud");
  await dispatch(page, { type: "cursor", t: 0 });
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).textContent.includes("1,000,000 of 3,000,000 points"),
    "a million of three are drawn",
    id,
  );
  alike(
    await colorAt(page, id, [1, 1, 0], { span: 6 }),
    await view(page, id, (v) => v && [44, 44, 120]),
    "by height, all low",
    0.85,
  );
});

test("11 space: when the viewer stops moving, all visible points are drawn", async ({ page }) => {
  const id = await openSpace(page, "space-big", "Cloud");
  await dispatch(page, { type: "cursor", t: 0 });
  const look = (from, to) => view(page, id, (v, [a, b]) => (v.stage.view.lookFrom(a, b), v.render()), [from, to]);
  const says = (words) =>
    until(page, ([i, w]) => new RegExp(w).test(document.querySelector(`#${i} .cell-info`).textContent), words, [
      id,
      words,
    ]);
  // All three million points are visible, of which a million is drawn.
  await look([0.9, 1, 6], [1, 1, 0]);
  await says("seen from here 1,000,000 of 3,000,000");
  // In a few columns of the grid, 300 points are at the same position.
  await look([0.999, 1, 0.15], [1, 1, 0]);
  await says("1,000,000 of 3,000,000 points; seen from here all ");
  const text = await page.textContent(`#${id} .cell-info`);
  const count = Number(/all ([\d,]+)/.exec(text)[1].replaceAll(",", ""));
  ok(count > 0 && count % 300 === 0 && count < 60_000, text);
  const drawn = () =>
    view(page, id, (v) =>
      [...v.stage.layers.values()].map((l) => [!!l.near, l.parts[0].object.visible, l.parts[0].item.count]),
    );
  equal(
    await drawn(),
    [
      [false, false, 1_000_000],
      [true, true, count],
    ],
    "the rough cloud is hidden, the near one drawn",
  );
  // The next message is drawn completely.
  await dispatch(page, { type: "cursor", t: S });
  await settled(page);
  const after = await drawn();
  equal(after.length, 1, "nothing of the other message is left");
  equal(after[0].slice(0, 2), [false, true], "the next cloud");
});

test("11 space: several panels share one context, and release their resources", async ({ page }) => {
  const id = await openSpace(page, "space.0000", "A.Points");
  const held = () => view(page, id, (v) => v.stage.memory().geometries);
  await settled(page);
  const few = await held();
  for (let i = 0; i < 20; i++) {
    await dispatch(page, { type: "cursor", t: (i % 10) * S });
    await settled(page);
  }
  ok((await held()) <= few + 4, `${few} geometries before, ${await held()} after 20 moves`);
});
