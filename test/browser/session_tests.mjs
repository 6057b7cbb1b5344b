// Annotating the sessions of a dataset: layers of each session, other browsers, the review of proposals, and moving
// between sessions.
import { spawnSync } from "node:child_process";
import { test, equal, ok, until } from "./harness.mjs";
import { open, state, dispatch, settled, typeNewAnnotations } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

// Returns the layers on disk, as the library reads them.
function readLayers() {
  const run = '. bin/lib/common.sh; elixir_prod test/browser/layers.exs "$@"';
  const args = ["-c", run, "bash", `${site.studied_folder}/study.json`];
  const { stdout, stderr } = spawnSync("bash", args, { encoding: "utf8" });
  try {
    return JSON.parse(stdout.trim().split("\n").pop());
  } catch {
    throw new Error(`the layers cannot be read: ${stdout} ${stderr}`);
  }
}

// Waits until the layers on disk fulfil a condition.
async function readSaved(fulfils) {
  for (let n = 0; n < 60; n++) {
    const layers = readLayers();
    if (fulfils(layers)) return layers;
  }
  throw new Error("the layers were not saved");
}

const itemCount = (page, n) =>
  until(page, (k) => window.situStudio.annotation?.state.items.length === k, `${n} annotations`, n);

async function createLayer(page, name) {
  await typeNewAnnotations(page, name);
  await until(page, (n) => window.situStudio.annotation?.state.stream === n, "the layer is open", name);
}

// Annotates a second with the key of a value, on a track.
async function annotate(page, track, at, key) {
  await page.evaluate((t) => void (window.situStudio.annotation.track = t), track);
  await dispatch(page, { type: "nudge", by: at * S - (await state(page)).cursor });
  await page.keyboard.press(key);
  await dispatch(page, { type: "nudge", by: S });
  await page.keyboard.press(key);
}

async function isSession(page, name) {
  await until(
    page,
    (n) =>
      document.querySelector("h1.where")?.textContent === n &&
      document.body.dataset.ready === "1" &&
      document.querySelector("[data-phx-main].phx-connected"),
    `session ${name} is shown`,
    name,
  );
  await settled(page);
}

test("10 sessions: two sessions are annotated on two tiers, and everything is there again", async ({
  page,
  browser,
  shot,
}) => {
  const other = await (await browser.newContext({ viewport: { width: 1280, height: 720 } })).newPage();
  try {
    await open(page, site.studied, "study.json/s1");
    await open(other, site.studied, "study.json/s1");
    await createLayer(page, "Turns");
    // The other browser shows the layer in the tree and the automatic layout.
    await until(other, () => document.querySelector("#tree .node[data-stream='Annotations.Turns']"), "in the tree");
    const shown = () =>
      [...document.querySelectorAll("[phx-hook='Panel']")].some((e) =>
        JSON.parse(e.dataset.config).vis.some((v) => v.stream === "Annotations.Turns"),
      );
    await until(other, shown, "in the layout");
    await annotate(page, "Ada", 5, "1");
    await annotate(page, "Ben", 8, "2");
    await itemCount(page, 2);
    await until(
      other,
      () =>
        [...window.situStudio.client.channels.values()].some(
          (c) => c.spec?.stream === "Annotations.Turns" && c.segments?.get("Ben")?.[0][2] === "laughs",
        ),
      "the other browser draws the edits",
    );
    // It edits the same layer.
    await other.keyboard.press("a");
    await other.click("#annotation-dialog button:text('Turns')");
    await itemCount(other, 2);
    await annotate(other, "Ada", 12, "2");
    await itemCount(page, 3);
    await shot("session-annotation");
    // The next session keeps the cursor, and offers to continue with the layer.
    await dispatch(page, { type: "view", from: 2 * S, to: 30 * S });
    await dispatch(page, { type: "nudge", by: 20 * S - (await state(page)).cursor });
    await page.keyboard.press("Alt+PageDown");
    await isSession(page, "s2");
    const { view, cursor } = await state(page);
    equal([view, cursor], [[2 * S, 30 * S], 20 * S], "the view and the cursor are kept");
    await page.click("#annotation-dialog button:has-text('Start Turns')");
    await until(page, () => window.situStudio.annotation?.state.stream === "Turns", "the layer is open");
    await annotate(page, "Ada", 3, "1");
    await annotate(page, "Ben", 4, "1");
    await itemCount(page, 2);
    // And back.
    await page.click(".topbar button[data-act='previousSession']");
    await isSession(page, "s1");
    await itemCount(page, 3);
  } finally {
    await other.context().close();
  }
  // When the last page that shows a layer is closed, the layer is saved.
  await page.goto("about:blank");
  const layers = await readSaved((l) => l.reduce((n, { items }) => n + items.length, 0) === 5);
  equal(
    layers.map((l) => [l.session, l.layer, l.items]),
    [
      [
        "s1",
        "Turns",
        [
          ["Ada", S, "speaks", false],
          ["Ben", S, "laughs", false],
          ["Ada", S, "laughs", false],
        ],
      ],
      [
        "s2",
        "Turns",
        [
          ["Ada", S, "speaks", false],
          ["Ben", S, "speaks", false],
        ],
      ],
    ],
    "the layers on disk",
  );
});

test("10 sessions: proposals of another partition are copied and reviewed with keys", async ({ page, shot }) => {
  await open(page, site.studied, "study.json/s1");
  await page.keyboard.press("a");
  await page.click("#annotation-dialog button:has-text('Copy Speech of Detected')");
  await itemCount(page, 40);
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("Home");
  await page.keyboard.press("q");
  const playing = (n) => {
    const { mode, play, repeat } = window.situStudio.time.get();
    return mode === "play" && repeat && play[0] === n * 1e9 && play[1] === n * 1e9 + 5e8;
  };
  await until(page, playing, "the first proposal is played in a loop", 0);
  const progress = (text) =>
    until(page, (t) => document.querySelector(".annotation-tools i.progress").textContent === t, text, text);
  await page.keyboard.press("Enter");
  await until(page, playing, "the second proposal is played", 1);
  await page.keyboard.press("Delete");
  await until(page, playing, "the third proposal is played", 2);
  await page.keyboard.press("2");
  await progress("3 of 40 reviewed, 2 accepted, 1 of them corrected");
  await page.keyboard.press("n");
  await until(page, playing, "a proposal is skipped", 4);
  await page.keyboard.press("N");
  await until(page, playing, "and shown again", 3);
  await shot("session-review");
  await page.keyboard.press("Control+z");
  await progress("2 of 40 reviewed, 1 accepted");
  await page.keyboard.press("Escape");
  await until(page, () => window.situStudio.time.get().mode !== "play", "the review ends");
  const values = await page.evaluate(
    () => window.situStudio.annotation.state.items.filter((a) => !a.proposed).length,
  );
  equal(values, 1, "one annotation");
  await page.click(".annotation-tools button:has-text('Save')");
  await until(page, () => document.getElementById("toast").textContent === "Annotations saved", "saved");
  const copy = readLayers().find((l) => l.session === "s1" && l.layer === "Speech");
  equal(copy.items.length, 39, "the rejected proposal is gone");
  const { total, reviewed, accepted, rejected, corrected } = copy.review;
  equal([total, reviewed, accepted, rejected, corrected], [40, 2, 1, 1, 0], "the counts are kept");
});

test("10 sessions: a double click in the dataset opens a session with the last view", async ({ page }) => {
  await open(page, site.studied, "study.json/s1");
  await dispatch(page, { type: "view", from: 1 * S, to: 11 * S });
  await dispatch(page, { type: "nudge", by: 6 * S - (await state(page)).cursor });
  await until(page, () => sessionStorage.getItem("situ:session study.json")?.includes("since=6000000000"), "kept");
  await page.goto(`${site.studied}/d/study.json`);
  await page.dblclick("#tree .node.session:has-text('s3')");
  await isSession(page, "s3");
  const { view, cursor } = await state(page);
  equal([view, cursor], [[1 * S, 11 * S], 6 * S], "the view and the cursor");
  await page.keyboard.press("Alt+PageDown");
  await until(page, () => document.getElementById("toast").textContent === "This is the last session", "the end");
  ok(!(await page.$("#annotation")), "nothing is annotated without a layer");
});

// A newcomer's walk: the clicks, keys and waiting time to segment and transcribe three sessions. Typed texts and the
// time of playback depend on the person, so only what the studio asks for is limited.
test("12 sessions: three sessions get two tiers each with few clicks and keys", async ({ page }) => {
  const used = { clicks: 0, keys: 0 };
  const click = async (selector, options) => {
    used.clicks += options?.clickCount ?? 1;
    await page.click(selector, options);
  };
  const press = async (key) => {
    used.keys += 1;
    await page.keyboard.press(key);
  };
  const begun = Date.now();
  await page.goto(`${site.studied}/d/study.json`);
  await click('#tree .node:has(.name:text-is("s1")) .name', { clickCount: 2 });
  await isSession(page, "s1");
  await press("a");
  await click("#annotation-new input[name=name]");
  await page.keyboard.type("Interview");
  await page.selectOption("#annotation-new select[name=kind]", "tiers");
  used.clicks += 2;
  await click("#annotation-new textarea");
  await page.keyboard.type("Speech: speaks, laughs\nWords of Speech");
  await click("#annotation-new .primary");
  for (const name of ["s1", "s2", "s3"]) {
    await until(page, () => window.situStudio.annotation?.state.tiers.length === 2, `the tiers of ${name}`);
    await page.focus("#annotation-body");
    await press("g");
    await press("g");
    await press("Space");
    await until(page, () => window.situStudio.time.get().mode === "play", "plays");
    for (let i = 0; i < 3; i++) {
      const { cursor } = await state(page);
      await press("Enter");
      await until(page, (c) => window.situStudio.time.get().cursor > c + 1e8, "time passes", cursor);
    }
    await press("Space");
    await itemCount(page, 2);
    await press("Escape");
    await press("Escape");
    await press("T");
    await until(page, () => document.querySelectorAll(".transcription input").length === 2, "two rows");
    for (const text of ["yes", "no"]) {
      await page.keyboard.type(text);
      await press("Enter");
    }
    await itemCount(page, 4);
    await press("Escape");
    if (name === "s3") break;
    await press("Alt+PageDown");
    await isSession(page, name === "s1" ? "s2" : "s3");
    await until(page, () => document.querySelector("#annotation-dialog"), "the layer is offered");
    await click("#annotation-dialog .primary");
  }
  await click(".annotation-tools button:text('Save')");
  await readSaved((all) => all.filter((l) => l.layer === "Interview" && l.items.length === 4).length === 3);
  console.log(`walk: ${used.clicks} clicks, ${used.keys} keys, ${((Date.now() - begun) / 1000).toFixed(1)} s`);
  ok(used.clicks <= 10, `few clicks: ${used.clicks}`);
  ok(used.keys <= 45, `few keys: ${used.keys}`);
});
