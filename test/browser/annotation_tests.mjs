// Annotating in the page, with the keyboard and with the mouse, and after the server restarts.
import { spawn } from "node:child_process";
import { mkdirSync, rmSync, writeFileSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
import { answer, open, state, dispatch, panelOf, pointAt, settled, typeNewAnnotations } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

const items = (page) =>
  page.evaluate(() =>
    window.situStudio.annotation.state.items.map((a) => [a.from, a.to, a.track, Object.values(a.values)[0]]),
  );

// Creates annotations with the keyboard: the dialog, a name, and two values with keys.
async function begin(page, name) {
  await typeNewAnnotations(page, name);
  await until(page, () => window.situStudio.annotation?.state.attributes.length === 1, "the panel is shown");
}

test("10 annotation: twenty segments are made, undone and saved with the keyboard alone", async ({ page, shot }) => {
  await open(page, site.main, "minute.0000");
  await page.keyboard.press("Home");
  await begin(page, "Speech");
  for (let i = 0; i < 20; i++) {
    const key = String(1 + (i % 2));
    await page.keyboard.press(key);
    for (let k = 0; k < 3; k++) await page.keyboard.press("Control+Shift+.");
    await page.keyboard.press(key);
    await page.keyboard.press("ArrowRight");
    await until(page, (n) => window.situStudio.annotation.state.items.length === n, `segment ${i + 1}`, i + 1);
  }
  const made = await items(page);
  for (const [i, [from, to, , value]] of made.entries()) {
    near(to - from, S / 2, 1e3, "three steps long");
    equal(value, i % 2 ? "laughs" : "speaks", "its value");
  }
  await shot("annotation");
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Control+z");
  await until(page, () => window.situStudio.annotation.state.items.length === 19, "undone");
  await page.keyboard.press("Control+Shift+z");
  await until(page, () => window.situStudio.annotation.state.items.length === 20, "redone");
  equal(await page.$$eval("[data-panel]", (p) => p.length > 3), true, "the layout is restored");
  await page.click(".annotation-tools button:text('Save')");
  await until(page, () => document.getElementById("toast").textContent === "Annotations saved", "saved");
  await until(
    page,
    () =>
      [...document.querySelectorAll(".annotation-tools button")].some((b) => b.textContent === "Saved" && b.disabled),
    "there is nothing to save",
  );
});

test("10 annotation: a key held during playback makes a segment of that length", async ({ page }) => {
  await open(page, site.main, "uneven.0000");
  await begin(page, "Held");
  await dispatch(page, { type: "nudge", by: 10 * S });
  await page.keyboard.press("Space");
  await until(page, () => window.situStudio.time.get().mode === "play", "plays");
  const cursor = async () => (await state(page)).cursor;
  const before = await cursor();
  await page.keyboard.down("1");
  const pressed = await cursor();
  await until(page, (t) => window.situStudio.time.get().cursor > t + 1e9, "a second is played", pressed);
  const late = await cursor();
  await page.keyboard.up("1");
  const released = await cursor();
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "one annotation");
  const [[a, b]] = await items(page);
  // Times are sent as integer nanoseconds.
  ok(before - 1 <= a && a <= pressed + 1, `from where it was pressed: ${a} is between ${before} and ${pressed}`);
  ok(late - 1 <= b && b <= released + 1, `to where it was released: ${b} is between ${late} and ${released}`);
});

test("10 annotation: dragging an edge moves a touching neighbor, and proposals are accepted", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  await begin(page, "Edges");
  for (const [from, to, key] of [
    [10, 20, "1"],
    [20, 30, "2"],
  ]) {
    await dispatch(page, { type: "nudge", by: from * S - (await state(page)).cursor });
    await page.keyboard.press(key);
    await dispatch(page, { type: "nudge", by: to * S - (await state(page)).cursor });
    await page.keyboard.press(key);
  }
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "two that touch");
  await settled(page);
  const row = await page.$eval(
    "#annotation-body",
    (e) => e.getBoundingClientRect().top + window.situStudio.annotation.toolsHeight + 13,
  );
  const start = await pointAt(page, "annotation-body", 20 * S);
  await page.mouse.move(start.x, row);
  await page.mouse.down();
  const end = await page.evaluate(() => {
    const s = window.situStudio,
      box = document.getElementById("annotation-body").getBoundingClientRect();
    const [a, b] = s.time.get().view;
    return box.left + s.gutter.left + ((24.3e9 - a) / (b - a)) * (box.width - s.gutter.left - 14);
  });
  await page.keyboard.down("Shift");
  await page.mouse.move(end, row, { steps: 6 });
  await page.mouse.up();
  await page.keyboard.up("Shift");
  await until(page, () => window.situStudio.annotation.state.items[0].to > 23e9, "the edge has moved");
  const [first, second] = await items(page);
  near(first[1], 24.3 * S, 0.3 * S, "to the mouse");
  equal(first[1], second[0], "the neighbor's edge moves with it");
  // With a snapped cursor, an edge moves to a message of that stream.
  await page.evaluate(() => window.situStudio.snapTo("Vad.Speaking"));
  await page.mouse.move(end, row);
  await page.mouse.down();
  await page.mouse.move(end + 31, row, { steps: 4 });
  await page.mouse.up();
  await until(page, (to) => window.situStudio.annotation.state.items[0].to !== to, "it has moved again", first[1]);
  const [[, snapped]] = await items(page);
  equal(await page.evaluate((t) => window.situStudio.nearestMessageTime(t + 2), snapped), snapped, "to a message");
  ok(snapped > first[1], "it has moved on");
  await page.evaluate(() => window.situStudio.snapTo(null));
  await page.click("#tree .node[data-stream='Vad.Speaking']", { button: "right" });
  await page.click("#menu button:has-text('Propose annotations')");
  await until(
    page,
    () => window.situStudio.annotation.state.items.filter((a) => a.proposed).length === 6,
    "six proposals",
  );
  await shot("proposals");
  await page.click(".annotation-tools button:has-text('Accept 6')");
  await until(page, () => window.situStudio.annotation.state.items.every((a) => !a.proposed), "all are accepted");
  // The confidence of proposals from numbers is the number. Those above the threshold are accepted, the others
  // rejected.
  await page.click("#tree .node[data-stream='Speech.Scores']", { button: "right" });
  await page.click("#menu button:has-text('Propose annotations')");
  await answer(page, "0.7");
  const proposed = () => page.evaluate(() => window.situStudio.annotation.state.items.filter((a) => a.proposed));
  await until(page, () => window.situStudio.annotation.state.items.some((a) => a.proposed), "proposals of numbers");
  ok(
    (await proposed()).every((a) => a.confidence >= 0.7 && a.confidence <= 1),
    "their confidence is the mean of the numbers",
  );
  const n = (await proposed()).length;
  await page.focus(".annotation-tools input[type=range]");
  await page.keyboard.press("End");
  await until(
    page,
    (all) =>
      [...document.querySelectorAll(".annotation-tools button")].some((b) => b.textContent === `Reject ${all}`),
    "the slider shows the number",
    n,
  );
  await page.click(`.annotation-tools button:has-text('Reject ${n}')`);
  await until(page, () => window.situStudio.annotation.state.items.every((a) => !a.proposed), "all are rejected");
});

test("10 annotation: menus of an annotation, a track and all annotations; rows for attributes", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "uneven.0000");
  // Another run with a new name keeps the existing layer.
  const name = `Menus ${Date.now()}`;
  await begin(page, name);
  await page.click(".annotation-tools button:text('Schema…')");
  await page.click("#schema-dialog button:text('Another attribute')");
  await page.fill("#schema-dialog input[name='attribute[1][name]']", "Mood");
  await page.fill("#schema-dialog input[name='attribute[1][values][0][value]']", "calm");
  await page.click("#schema-dialog button:text('Keep for other recordings')");
  await until(page, () => document.getElementById("toast").textContent.startsWith("Saved as"), "the schema is saved");
  await page.click("#schema-dialog button:text('Save')");
  await until(page, () => window.situStudio.annotation.visibleRows().length === 2, "a row for each attribute");
  const make = async (from, to) => {
    await dispatch(page, { type: "select", from: from * S, to: to * S });
    await page.focus("#annotation-body");
    await page.keyboard.press("Enter");
  };
  await make(10, 20);
  await make(30, 40);
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "two annotations");
  const menu = async (t, row, item) => {
    const { x } = await pointAt(page, "annotation-body", t * S);
    const y = await page.$eval(
      "#annotation-body",
      (e, r) => e.getBoundingClientRect().top + window.situStudio.annotation.toolsHeight + 13 + 26 * r,
      row,
    );
    await page.mouse.click(x, y, { button: "right" });
    await page.click(`#menu button:has-text("${item}")`);
  };
  await menu(15, 1, "laughs");
  await until(page, (n) => window.situStudio.annotation.state.items[0].values[n] === "laughs", "a value", name);
  equal(await page.evaluate(() => window.situStudio.annotation.attribute), 1, "the attribute of the row is chosen");
  await menu(15, 0, "Merge with the next");
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "joined");
  equal((await items(page))[0].slice(0, 2), [10 * S, 40 * S], "from the first to the last");
  await menu(15, 0, "To another track");
  await answer(page, "Ada");
  await until(page, () => window.situStudio.annotation.state.items[0].track === "Ada", "moved");
  await page.focus("#annotation-body");
  await page.click(".annotation-tools button:text('Track…')");
  await answer(page, "Ben");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Copy boundaries to track Ben')");
  await answer(page, "Ada");
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "boundaries are copied");
  equal((await items(page))[1].slice(0, 3), [10 * S, 40 * S, "Ben"], "a copy on its own track");
  await shot("annotation-rows");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Selected track only')");
  await until(page, () => window.situStudio.annotation.visibleRows().length === 2, "one track is shown");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Delete all on track Ben')");
  await answer(page);
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "deleted");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Undo')");
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "and back");
  // Uses a saved schema in another recording.
  await open(page, site.main, "many.0000");
  await page.keyboard.press("a");
  await page.fill("#annotation-new input[name=name]", `Again ${Date.now()}`);
  await page.selectOption("#annotation-new select[name=schema]", name);
  await page.click("#annotation-new button[type=submit]");
  await until(page, () => window.situStudio.annotation?.state.attributes.length === 2, "it has both attributes");
});

test("10 annotation: a restarted server has every edit", async ({ page }) => {
  await open(page, site.mortal, "many.0000");
  await begin(page, "Lasting");
  await page.keyboard.press("1");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("1");
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "one annotation");
  await until(
    page,
    () => new URLSearchParams(location.search).get("annotate") === "Lasting",
    "the address includes it",
  );
  writeFileSync(site.away, "");
  await until(page, () => document.body?.dataset.connection === "closed", "the server is down");
  rmSync(site.away);
  await until(
    page,
    () => window.situStudio?.annotation?.state.items.length === 1 && document.body?.dataset.connection === "open",
    "the server is up again",
  );
});

const add = (page, from, to, track, values = {}) =>
  page.evaluate(
    ([a, b, t, v]) => {
      const { annotation, client } = window.situStudio;
      annotation.pushEdit("add", { from: client.toAbsolute(a), to: client.toAbsolute(b), track: t, values: v });
    },
    [from, to, track, values],
  );

test("10 annotation: annotations follow changes of the schema; notes and confidence are kept", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "many.0000");
  await begin(page, "Schema");
  await add(page, 1 * S, 3 * S, "1", { Schema: "speaks" });
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "one annotation");
  await page.click(".annotation-tools button:text('Schema…')");
  await until(page, () => document.querySelector("#schema"), "the schema is shown");
  await page.fill("[name='attribute[0][values][0][value]']", "talks");
  await page.fill("[name='attribute[0][values][0][key]']", "k");
  await page.click("#schema button:text('Another value')");
  await page.fill("[name='attribute[0][values][2][value]']", "sings");
  await page.click("#schema button:text('Another attribute')");
  await page.fill("[name='attribute[1][name]']", "Loud");
  await page.selectOption("[name='attribute[1][kind]']", "bool");
  await shot("schema");
  await page.click("#schema button[type=submit]");
  await until(page, () => window.situStudio.annotation.state.attributes.length === 2, "two attributes");
  const [a] = await page.evaluate(() => window.situStudio.annotation.state.items);
  equal(a.values, { Schema: "talks", Loud: false }, "the annotation has the new names");
  // Values that annotations use cannot be removed.
  await page.click(".annotation-tools button:text('Schema…')");
  await page.click("#schema button[aria-label='Remove talks']");
  await until(
    page,
    () => !document.querySelector("#schema button[aria-label='Remove talks']"),
    "the value is removed",
  );
  await page.click("#schema button[type=submit]");
  await until(
    page,
    () => document.querySelector("#schema .error")?.textContent.includes("talks"),
    "an error is shown",
  );
  await page.keyboard.press("Escape");
  await until(page, () => !document.querySelector("#schema"), "closed");
  // The new key works immediately.
  await dispatch(page, { type: "nudge", by: 5 * S - (await state(page)).cursor });
  await page.keyboard.press("k");
  await dispatch(page, { type: "nudge", by: 2 * S });
  await page.keyboard.press("k");
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "by its new key");
  // With a selection by keyboard, edges move to the cursor, and a note and a confidence are set.
  await page.focus("#annotation-body");
  await page.keyboard.press("Shift+ArrowLeft");
  await until(page, () => document.querySelector(".annotation-tools input[type=text]:not([hidden])"), "it is chosen");
  await dispatch(page, { type: "nudge", by: 8 * S - (await state(page)).cursor });
  await page.keyboard.press("]");
  await until(page, () => window.situStudio.annotation.findItem()?.to === 8e9, "its end is at the cursor");
  await page.fill(".annotation-tools [aria-label='Note']", "hard to hear");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.findItem()?.note === "hard to hear", "a note");
  await page.fill(".annotation-tools [aria-label='Confidence, 0 to 1']", "0.6");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.findItem()?.confidence === 0.6, "a confidence");
});

test("10 annotation: each annotator has a layer, and agreement of two annotators is shown", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "uneven.0000");
  await begin(page, "Turns");
  await add(page, 10 * S, 30 * S, "1", { Turns: "speaks" });
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "the first annotator's");
  await page.click(".annotation-tools button:text('×')");
  await until(page, () => !document.getElementById("annotation-body"), "closed");
  await page.keyboard.press("a");
  await page.selectOption("#annotation-own select", "Turns");
  await page.fill("#annotation-own input", "Ada");
  await page.click("#annotation-own button");
  await until(page, () => window.situStudio.annotation?.state.stream === "Turns.Ada", "her own layer");
  equal(await page.evaluate(() => window.situStudio.annotation.state.items.length), 0, "which is empty");
  await dispatch(page, { type: "select", from: 12 * S, to: 30 * S });
  await page.focus("#annotation-body");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.state.items[0]?.by === "Ada", "her annotation has her name");
  await page.click(".annotation-tools button:text('Save')");
  await page.click(".annotation-tools button:text('Agreement…')");
  await page.click("#agreement-with button:text('Turns')");
  await until(page, () => document.getElementById("agreement"), "the table");
  const rows = await page.$$eval("#agreement tr", (r) =>
    Object.fromEntries(r.map((e) => [...e.children].map((c) => c.textContent))),
  );
  // The annotators differ in two of twenty seconds (p_o = 0.9). One labels every second, the other leaves a tenth
  // unlabeled.
  equal(
    [rows["same label"], rows["mean start difference"], rows["mean end difference"], rows["annotations in both"]],
    ["90.0 %", "2.00 s", "0 ns", "1"],
    "they agree so far",
  );
  await shot("agreement");
});

test("10 annotation: boxes on images are drawn, moved and interpolated between key frames", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  await page.keyboard.press("a");
  await page.fill("#annotation-new [name=name]", "Cars");
  await page.selectOption("#annotation-new [name=kind]", "box");
  await page.click("#annotation-new button[type=submit]");
  await until(page, () => window.situStudio.annotation?.spatial.kind === "box", "boxes are annotated");
  const id = await panelOf(page, "Camera.Image");
  const at = async (s) => {
    await dispatch(page, { type: "nudge", by: s * S - (await state(page)).cursor });
    await until(
      page,
      ([i, t]) => document.querySelector(`#${i} canvas`).dataset.at === String(t),
      `the image of second ${s}`,
      [id, s * S],
    );
  };
  // Converts pixels of the image to pixels of the screen.
  const point = (x, y) =>
    page.evaluate(
      ([i, px, py]) => {
        const v = [...window.situStudio.views].find((w) => w.el.id === i),
          box = v.canvas.getBoundingClientRect(),
          map = v.map();
        return [box.left + map.x(px), box.top + map.y(py)];
      },
      [id, x, y],
    );
  const drag = async (from, to) => {
    await page.mouse.move(...(await point(...from)));
    await page.mouse.down();
    await page.mouse.move(...(await point(...to)), { steps: 4 });
    await page.mouse.up();
  };
  await at(10);
  await drag([5, 5], [25, 20]);
  await until(page, () => window.situStudio.annotation.state.items.length === 1, "a box");
  await at(20);
  // Nothing is interpolated after the last key frame, so the next box is drawn at its position at that time.
  await drag([35, 25], [55, 40]);
  await until(page, () => window.situStudio.annotation.state.items.length === 2, "the second key frame");
  const near1 = (found, wanted, what) => found.forEach((v, i) => near(v, wanted[i], 0.6, what));
  await at(15);
  const places = () =>
    page.evaluate((i) => {
      const v = [...window.situStudio.views].find((w) => w.el.id === i);
      return window.situStudio.annotation.spatial.listPositions(v).map(([track, p]) => [track, p.place, p.key]);
    }, id);
  const [[track, place, key]] = await places();
  equal([track, key], ["1", false], "between two key frames");
  near1(place, [20, 15, 20, 15], "half way between");
  await shot("boxes");
  // Moving the box at this time adds a key frame.
  await drag([30, 22], [34, 22]);
  await until(page, () => window.situStudio.annotation.state.items.length === 3, "a third key frame");
  near1((await places())[0][1], [24, 15, 20, 15], "moved");
  // A separate box becomes a separate track.
  await drag([2, 2], [10, 8]);
  await until(page, () => window.situStudio.annotation.state.tracks.length === 2, "a second track");
  await at(30);
  equal(await places(), [], "there is no box after the last key frame");
});

// Starts a studio in its own operating system process.
function studio(folder, port) {
  const run = '. bin/lib/common.sh; elixir_prod test/browser/annotated.exs "$@"';
  const child = spawn("bash", ["-c", run, "bash", folder, String(port), `${folder}/layouts`], {
    stdio: ["ignore", "pipe", "inherit"],
  });
  const ready = new Promise((resolve, reject) => {
    let text = "";
    child.stdout.on("data", (d) => {
      text += d;
      const found = /^ready (\d+)/m.exec(text);
      if (found) resolve(Number(found[1]));
    });
    child.on("exit", () => reject(new Error(`the studio ended: ${text}`)));
  });
  const ended = new Promise((resolve) => child.on("exit", resolve));
  return { child, ready, ended };
}

test("10 annotation: kill -9 of the server loses nothing", async ({ page }) => {
  const folder = `${site.folder}-killed`;
  mkdirSync(folder, { recursive: true });
  const first = studio(folder, 0);
  let second = null;
  try {
    const port = await first.ready;
    await open(page, `http://localhost:${port}`, "lasting.0000");
    await begin(page, "Lasting");
    for (const i of [1, 2, 3]) await add(page, i * 10 * S, (i * 10 + 5) * S, "1", { Lasting: "speaks" });
    await until(page, () => window.situStudio.annotation.state.items.length === 3, "three annotations");
    const before = await items(page);
    first.child.kill("SIGKILL");
    await first.ended;
    second = studio(folder, port);
    await second.ready;
    // After the server was away, the page may reload at any moment, so one probe reads all values.
    await until(
      page,
      (b) => {
        const told = window.situStudio?.annotation?.state.items ?? [];
        const now = told.map((a) => [a.from, a.to, a.track, Object.values(a.values)[0]]);
        return document.body?.dataset.connection === "open" && JSON.stringify(now) === b;
      },
      "all three are restored",
      JSON.stringify(before),
    );
    // The page continues, possibly after a reload.
    await until(
      page,
      () => {
        const panel = window.situStudio?.annotation;
        if (!panel || !document.querySelector("[data-phx-main].phx-connected")) return false;
        if (panel.state.items.length === 3 && !window.undone) {
          window.undone = true;
          panel.pushEdit("undo");
        }
        return panel.state.items.length === 2;
      },
      "the last one is undone",
    );
  } finally {
    first.child.kill("SIGKILL");
    second?.child.kill("SIGKILL");
    await second?.ended;
    rmSync(folder, { recursive: true, force: true });
  }
});
