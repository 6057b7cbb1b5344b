// Annotating in the page: by keys alone, by the mouse, and through the end of a server.
import { spawn } from "node:child_process";
import { mkdirSync, rmSync, writeFileSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
import { answer, open, state, dispatch, panelOf, pointAt, settled } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

const items = (page) =>
  page.evaluate(() =>
    window.situStudio.annotation.told.items.map((a) => [a.from, a.to, a.track, Object.values(a.values)[0]]),
  );

// From the keyboard: the dialog, a name, two values with keys.
async function begin(page, name) {
  await page.keyboard.press("a");
  await until(page, () => document.activeElement?.closest("#annotation-new"), "the dialog has the focus");
  await page.keyboard.type(name);
  await page.keyboard.press("Tab");
  await page.keyboard.type("speaks 1 #ff00ff");
  await page.keyboard.press("Enter");
  await page.keyboard.type("laughs 2");
  for (const _ of ["kind", "annotator"]) await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation?.told.attributes.length === 1, "the panel is there");
}

test("10 annotation: twenty segments by keys alone, undone and saved", async ({ page, shot }) => {
  await open(page, site.main, "minute.0000");
  await page.keyboard.press("Home");
  await begin(page, "Speech");
  for (let i = 0; i < 20; i++) {
    const key = String(1 + (i % 2));
    await page.keyboard.press(key);
    for (let k = 0; k < 3; k++) await page.keyboard.press("Control+Shift+.");
    await page.keyboard.press(key);
    await page.keyboard.press("ArrowRight");
    await until(page, (n) => window.situStudio.annotation.told.items.length === n, `segment ${i + 1}`, i + 1);
  }
  const made = await items(page);
  for (const [i, [from, to, , value]] of made.entries()) {
    near(to - from, S / 2, 1e3, "three steps long");
    equal(value, i % 2 ? "laughs" : "speaks", "its value");
  }
  await shot("annotation");
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Control+z");
  await until(page, () => window.situStudio.annotation.told.items.length === 19, "undone");
  await page.keyboard.press("Control+Shift+z");
  await until(page, () => window.situStudio.annotation.told.items.length === 20, "redone");
  equal(await page.$$eval("[data-panel]", (p) => p.length > 3), true, "the layout is as it was");
  await page.click(".annotation-tools button:text('Save')");
  await until(page, () => document.getElementById("toast").textContent === "Annotations saved", "saved");
  await until(
    page,
    () =>
      [...document.querySelectorAll(".annotation-tools button")].some((b) => b.textContent === "Saved" && b.disabled),
    "there is nothing to save",
  );
});

test("10 annotation: a key held while playing lasts as long as it is held", async ({ page }) => {
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
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "one annotation");
  const [[a, b]] = await items(page);
  // times travel as whole nanoseconds
  ok(before - 1 <= a && a <= pressed + 1, `from where it was pressed: ${a} is between ${before} and ${pressed}`);
  ok(late - 1 <= b && b <= released + 1, `to where it was released: ${b} is between ${late} and ${released}`);
});

test("10 annotation: edges are dragged, neighbours that touch go along; proposals are taken", async ({
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
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "two that touch");
  await settled(page);
  const row = await page.$eval(
    "#annotation-body",
    (e) => e.getBoundingClientRect().top + window.situStudio.annotation.head + 13,
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
  await until(page, () => window.situStudio.annotation.told.items[0].to > 23e9, "the edge has moved");
  const [first, second] = await items(page);
  near(first[1], 24.3 * S, 0.3 * S, "to the mouse");
  equal(first[1], second[0], "and the neighbour's with it");
  // with a snapped cursor an edge goes to a message of that stream
  await page.evaluate(() => window.situStudio.snapTo("Vad.Speaking"));
  await page.mouse.move(end, row);
  await page.mouse.down();
  await page.mouse.move(end + 31, row, { steps: 4 });
  await page.mouse.up();
  await until(page, (to) => window.situStudio.annotation.told.items[0].to !== to, "it has moved again", first[1]);
  const [[, snapped]] = await items(page);
  equal(await page.evaluate((t) => window.situStudio.nearest(t + 2), snapped), snapped, "to a message");
  ok(snapped > first[1], "further on");
  await page.evaluate(() => window.situStudio.snapTo(null));
  await page.click("#tree .node[data-stream='Vad.Speaking']", { button: "right" });
  await page.click("#menu button:has-text('Propose annotations')");
  await until(
    page,
    () => window.situStudio.annotation.told.items.filter((a) => a.proposed).length === 6,
    "six proposals",
  );
  await shot("proposals");
  await page.click(".annotation-tools button:has-text('Accept 6')");
  await until(page, () => window.situStudio.annotation.told.items.every((a) => !a.proposed), "all are taken");
  // of numbers, as sure as they are high: those of the threshold are taken, the others refused
  await page.click("#tree .node[data-stream='Speech.Scores']", { button: "right" });
  await page.click("#menu button:has-text('Propose annotations')");
  await answer(page, "0.7");
  const proposed = () => page.evaluate(() => window.situStudio.annotation.told.items.filter((a) => a.proposed));
  await until(page, () => window.situStudio.annotation.told.items.some((a) => a.proposed), "proposals of numbers");
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
    "the slider says how many",
    n,
  );
  await page.click(`.annotation-tools button:has-text('Reject ${n}')`);
  await until(page, () => window.situStudio.annotation.told.items.every((a) => !a.proposed), "all are refused");
});

test("10 annotation: the menu of an annotation, of its track, of all; rows for attributes", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "uneven.0000");
  // another name when it runs again: what was made stays
  const name = `Menus ${Date.now()}`;
  await begin(page, name);
  await page.click(".annotation-tools button:text('Schema…')");
  await page.click("#schema-dialog button:text('Another attribute')");
  await page.fill("#schema-dialog input[name='attribute[1][name]']", "Mood");
  await page.fill("#schema-dialog input[name='attribute[1][values][0][value]']", "calm");
  await page.click("#schema-dialog button:text('Keep for other recordings')");
  await until(page, () => document.getElementById("toast").textContent.startsWith("Kept"), "the schema is kept");
  await page.click("#schema-dialog button:text('Save')");
  await until(page, () => window.situStudio.annotation.rows().length === 2, "a row for each attribute");
  const make = async (from, to) => {
    await dispatch(page, { type: "select", from: from * S, to: to * S });
    await page.focus("#annotation-body");
    await page.keyboard.press("Enter");
  };
  await make(10, 20);
  await make(30, 40);
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "two annotations");
  const menu = async (t, row, item) => {
    const { x } = await pointAt(page, "annotation-body", t * S);
    const y = await page.$eval(
      "#annotation-body",
      (e, r) => e.getBoundingClientRect().top + window.situStudio.annotation.head + 13 + 26 * r,
      row,
    );
    await page.mouse.click(x, y, { button: "right" });
    await page.click(`#menu button:has-text("${item}")`);
  };
  await menu(15, 1, "laughs");
  await until(page, (n) => window.situStudio.annotation.told.items[0].values[n] === "laughs", "a value", name);
  equal(await page.evaluate(() => window.situStudio.annotation.attribute), 1, "the attribute of the row is chosen");
  await menu(15, 0, "Join it with the next");
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "joined");
  equal((await items(page))[0].slice(0, 2), [10 * S, 40 * S], "from the first to the last");
  await menu(15, 0, "To another track");
  await answer(page, "Ada");
  await until(page, () => window.situStudio.annotation.told.items[0].track === "Ada", "moved");
  await page.focus("#annotation-body");
  await page.click(".annotation-tools button:text('Track…')");
  await answer(page, "Ben");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Copy boundaries to track Ben')");
  await answer(page, "Ada");
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "boundaries are copied");
  equal((await items(page))[1].slice(0, 3), [10 * S, 40 * S, "Ben"], "to a track of one's own");
  await shot("annotation-rows");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('The chosen track only')");
  await until(page, () => window.situStudio.annotation.rows().length === 2, "one track is shown");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Delete all on track Ben')");
  await answer(page);
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "deleted");
  await page.keyboard.press("Shift+F10");
  await page.click("#menu button:has-text('Undo')");
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "and back");
  // a schema that was kept, in another recording
  await open(page, site.main, "many.0000");
  await page.keyboard.press("a");
  await page.fill("#annotation-new input[name=name]", `Again ${Date.now()}`);
  await page.selectOption("#annotation-new select[name=schema]", name);
  await page.click("#annotation-new button[type=submit]");
  await until(page, () => window.situStudio.annotation?.told.attributes.length === 2, "it has both attributes");
});

test("10 annotation: a server that is started again has every edit", async ({ page }) => {
  await open(page, site.mortal, "many.0000");
  await begin(page, "Lasting");
  await page.keyboard.press("1");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("1");
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "one annotation");
  await until(page, () => new URLSearchParams(location.search).get("annotate") === "Lasting", "the address names it");
  writeFileSync(site.away, "");
  await until(page, () => document.body?.dataset.connection === "closed", "the server is away");
  rmSync(site.away);
  await until(
    page,
    () => window.situStudio?.annotation?.told.items.length === 1 && document.body?.dataset.connection === "open",
    "it is back",
  );
});

const add = (page, from, to, track, values = {}) =>
  page.evaluate(
    ([a, b, t, v]) => {
      const { annotation, client } = window.situStudio;
      annotation.push("add", { from: client.abs(a), to: client.abs(b), track: t, values: v });
    },
    [from, to, track, values],
  );

test("10 annotation: the schema is edited, annotations follow; notes and confidence are kept", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "many.0000");
  await begin(page, "Schema");
  await add(page, 1 * S, 3 * S, "1", { Schema: "speaks" });
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "one annotation");
  await page.click(".annotation-tools button:text('Schema…')");
  await until(page, () => document.querySelector("#schema"), "the schema is there");
  await page.fill("[name='attribute[0][values][0][value]']", "talks");
  await page.fill("[name='attribute[0][values][0][key]']", "k");
  await page.click("#schema button:text('Another value')");
  await page.fill("[name='attribute[0][values][2][value]']", "sings");
  await page.click("#schema button:text('Another attribute')");
  await page.fill("[name='attribute[1][name]']", "Loud");
  await page.selectOption("[name='attribute[1][kind]']", "bool");
  await shot("schema");
  await page.click("#schema button[type=submit]");
  await until(page, () => window.situStudio.annotation.told.attributes.length === 2, "two attributes");
  const [a] = await page.evaluate(() => window.situStudio.annotation.told.items);
  equal(a.values, { Schema: "talks", Loud: false }, "the annotation has the new names");
  // what an annotation says cannot be taken away
  await page.click(".annotation-tools button:text('Schema…')");
  await page.click("#schema button[aria-label='Remove talks']");
  await until(page, () => !document.querySelector("#schema button[aria-label='Remove talks']"), "the value is gone");
  await page.click("#schema button[type=submit]");
  await until(page, () => document.querySelector("#schema .error")?.textContent.includes("talks"), "and it says so");
  await page.keyboard.press("Escape");
  await until(page, () => !document.querySelector("#schema"), "closed");
  // the new key works at once
  await dispatch(page, { type: "nudge", by: 5 * S - (await state(page)).cursor });
  await page.keyboard.press("k");
  await dispatch(page, { type: "nudge", by: 2 * S });
  await page.keyboard.press("k");
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "by its new key");
  // chosen by the keyboard: edges go to the cursor, a note and a confidence
  await page.focus("#annotation-body");
  await page.keyboard.press("Shift+ArrowLeft");
  await until(page, () => document.querySelector(".annotation-tools input[type=text]:not([hidden])"), "it is chosen");
  await dispatch(page, { type: "nudge", by: 8 * S - (await state(page)).cursor });
  await page.keyboard.press("]");
  await until(page, () => window.situStudio.annotation.item()?.to === 8e9, "its end is at the cursor");
  await page.fill(".annotation-tools [aria-label='Note']", "hard to hear");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.item()?.note === "hard to hear", "a note");
  await page.fill(".annotation-tools [aria-label='Confidence, 0 to 1']", "0.6");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.item()?.confidence === 0.6, "a confidence");
});

test("10 annotation: a layer for each annotator, and how far two agree", async ({ page, shot }) => {
  await open(page, site.main, "uneven.0000");
  await begin(page, "Turns");
  await add(page, 10 * S, 30 * S, "1", { Turns: "speaks" });
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "the first annotator's");
  await page.click(".annotation-tools button:text('×')");
  await until(page, () => !document.getElementById("annotation-body"), "closed");
  await page.keyboard.press("a");
  await page.selectOption("#annotation-own select", "Turns");
  await page.fill("#annotation-own input", "Ada");
  await page.click("#annotation-own button");
  await until(page, () => window.situStudio.annotation?.told.stream === "Turns.Ada", "a layer of her own");
  equal(await page.evaluate(() => window.situStudio.annotation.told.items.length), 0, "which is empty");
  await dispatch(page, { type: "select", from: 12 * S, to: 30 * S });
  await page.focus("#annotation-body");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation.told.items[0]?.by === "Ada", "what she makes bears her name");
  await page.click(".annotation-tools button:text('Save')");
  await page.click(".annotation-tools button:text('Agreement…')");
  await page.click("#agreement-with button:text('Turns')");
  await until(page, () => document.getElementById("agreement"), "the table");
  const rows = await page.$$eval("#agreement tr", (r) =>
    Object.fromEntries(r.map((e) => [...e.children].map((c) => c.textContent))),
  );
  // of twenty seconds two say otherwise: p_o = 0.9; one has no label in none, the other in a tenth
  equal(
    [rows["same label"], rows["begins apart by"], rows["ends apart by"], rows["annotations of both"]],
    ["90.0 %", "2.00 s", "0 ns", "1"],
    "they agree so far",
  );
  await shot("agreement");
});

test("10 annotation: boxes on pictures, drawn, moved, and between key frames on the line", async ({ page, shot }) => {
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
      `the picture of second ${s}`,
      [id, s * S],
    );
  };
  // pixels of the picture to those of the screen
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
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "a box");
  await at(20);
  // nothing goes on past the last key frame: the next is drawn where it is by then
  await drag([35, 25], [55, 40]);
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "its second key frame");
  const near1 = (found, wanted, what) => found.forEach((v, i) => near(v, wanted[i], 0.6, what));
  await at(15);
  const places = () =>
    page.evaluate((i) => {
      const v = [...window.situStudio.views].find((w) => w.el.id === i);
      return window.situStudio.annotation.spatial.places(v).map(([track, p]) => [track, p.place, p.key]);
    }, id);
  const [[track, place, key]] = await places();
  equal([track, key], ["1", false], "between two key frames");
  near1(place, [20, 15, 20, 15], "half way between");
  await shot("boxes");
  // moved there, it is a key frame of its own
  await drag([30, 22], [34, 22]);
  await until(page, () => window.situStudio.annotation.told.items.length === 3, "a third key frame");
  near1((await places())[0][1], [24, 15, 20, 15], "moved");
  // another box beside it is another track
  await drag([2, 2], [10, 8]);
  await until(page, () => window.situStudio.annotation.told.tracks.length === 2, "a second track");
  await at(30);
  equal(await places(), [], "past the last key frame there is none");
});

// A studio in an operating-system process of its own.
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

test("10 annotation: kill -9 of the server takes nothing along", async ({ page }) => {
  const folder = `${site.folder}-killed`;
  mkdirSync(folder, { recursive: true });
  const first = studio(folder, 0);
  let second = null;
  try {
    const port = await first.ready;
    await open(page, `http://localhost:${port}`, "lasting.0000");
    await begin(page, "Lasting");
    for (const i of [1, 2, 3]) await add(page, i * 10 * S, (i * 10 + 5) * S, "1", { Lasting: "speaks" });
    await until(page, () => window.situStudio.annotation.told.items.length === 3, "three annotations");
    const before = await items(page);
    first.child.kill("SIGKILL");
    await first.ended;
    second = studio(folder, port);
    await second.ready;
    // a page whose server was away loads once more, at any moment: all is asked at once
    await until(
      page,
      (b) => {
        const told = window.situStudio?.annotation?.told.items ?? [];
        const now = told.map((a) => [a.from, a.to, a.track, Object.values(a.values)[0]]);
        return document.body?.dataset.connection === "open" && JSON.stringify(now) === b;
      },
      "all three are there again, as they were",
      JSON.stringify(before),
    );
    // and the page, which may load once more, goes on
    await until(
      page,
      () => {
        const panel = window.situStudio?.annotation;
        if (!panel || !document.querySelector("[data-phx-main].phx-connected")) return false;
        if (panel.told.items.length === 3 && !window.undone) {
          window.undone = true;
          panel.push("undo");
        }
        return panel.told.items.length === 2;
      },
      "the last one is taken back",
    );
  } finally {
    first.child.kill("SIGKILL");
    second?.child.kill("SIGKILL");
    await second?.ended;
    rmSync(folder, { recursive: true, force: true });
  }
});
