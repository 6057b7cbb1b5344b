// A selection saved as an HTML page, opened from the file without a server.
import { readFileSync, renameSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, dispatch, legendOf, panelOf } from "./studio_page.mjs";
import { objections } from "./axe.mjs";

const site = JSON.parse(process.argv[2]);
const MS = 1e6,
  S = 1e9;

// Saves the selection of a recording as a page, and opens the file. Returns the new page and its requests.
async function savePage(page, context, recording, [from, to], name) {
  await open(page, site.main, recording);
  await dispatch(page, { type: "select", from, to });
  await page.keyboard.press("Control+Shift+E");
  await until(page, () => document.querySelector("#film-file"), "the page is written");
  ok(/Download \(\d+\.\d\d MB\)/.test(await page.textContent("#film-file")), "its size is stated before it is saved");
  const [file] = await Promise.all([page.waitForEvent("download"), page.click("#film-file")]);
  equal(file.suggestedFilename(), "selection.html", "the name of the file");
  const path = `${site.folder}/../${name}.html`;
  renameSync(await file.path(), path);
  const saved = await context.newPage();
  const requests = [];
  saved.on("request", (r) => requests.push(r.url()));
  saved.on("pageerror", (e) => requests.push(`error: ${e.message}`));
  await saved.goto(`file://${path}`);
  await until(saved, () => document.body?.dataset.ready === "1", "the file has data");
  await settled(saved);
  return { saved, requests };
}

test("7 file: values under the cursor of a saved page agree with the messages at any zoom", async ({
  page,
  context,
  shot,
}) => {
  const zoo = JSON.parse(readFileSync(site.zoo, "utf8"));
  const [first, last] = [10_000, 40_000];
  const { saved, requests } = await savePage(page, context, "zoo.0000", [first * MS, last * MS], "zoo");
  let seed = 33;
  const next = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
  let compared = 0;
  for (let round = 0; round < 20; round++) {
    const width = (last - first) * MS * 0.001 ** next();
    const from = next() * ((last - first) * MS - width);
    await dispatch(saved, { type: "view", from, to: from + width });
    const t = Math.round(from + (0.1 + 0.8 * next()) * width);
    await dispatch(saved, { type: "cursor", t });
    await settled(saved);
    for (const name of ["Zoo.Regular", "Zoo.Irregular"]) {
      const row = zoo[name].findLast(([ms]) => ms * MS <= t + first * MS);
      const { exact } = await legendOf(saved, name);
      equal(Number(exact), row[1], `${name} at ${t / MS} ms of the selection`);
      compared++;
    }
    const found = await saved.evaluate(stateAt, ["Zoo.State", t]);
    const row = zoo["Zoo.State"].findLast(([ms]) => ms * MS <= t + first * MS);
    if (found) equal(found, String(row[1]), `Zoo.State at ${t / MS} ms of the selection`);
    compared++;
  }
  equal(compared, 60, "values were compared");
  equal(requests, [saved.url()], "the file is all that the page loads");
  equal(await objections(saved), [], "axe");
  if (process.env.SHOTS) await saved.screenshot({ path: `${process.env.SHOTS}/saved-zoo.png` });
  await shot("page-saved");
});

// Runs in the page. Returns the label of the state of a stream at a time, if it is a single one.
function stateAt([stream, t]) {
  for (const v of window.situStudio.views) {
    const row = v.rows?.find((r) => r.l.vis.stream === stream);
    const found = row?.l.channel.segments.get("")?.find(([a, b]) => a <= t && t < b);
    if (found && found[3] !== "many") return found[2];
  }
  return null;
}

test("7 file: a saved page has images with their overlays and sound, and its own tools", async ({
  page,
  context,
}) => {
  const { saved, requests } = await savePage(page, context, "minute.0000", [20 * S, 26 * S], "minute");
  await dispatch(saved, { type: "cursor", t: 2.5 * S });
  await settled(saved);
  const id = await panelOf(saved, "Camera.Image");
  near(Number(await saved.getAttribute(`#${id} canvas`, "data-at")), 2 * S, 1, "the image of the second second");
  const faces = await saved.evaluate((panel) => {
    const view = [...window.situStudio.views].find((v) => v.el.id === panel);
    return view.layers.find((l) => l.vis.stream === "Camera.Faces")?.shapes?.rects?.length;
  }, id);
  equal(faces, 1, "the rectangle over the image");
  const sound = await saved.evaluate(async () => {
    const { playback } = window.situStudio;
    const [found] = playback.sounds();
    const pcm = await playback.fetchPcm(found, 1e9, 2e9);
    return { rate: pcm.rate, samples: pcm.samples.length, loudest: Math.max(...pcm.samples) };
  });
  equal([sound.rate, sound.samples], [16_000, 16_000], "a second of sound");
  near(sound.loudest > 0.1 ? 12_000 / 32_768 : 0, sound.loudest, 0.01, "as loud as recorded, or silent");

  // m maximizes a panel, a name hides its line, and keys that need a server are not listed
  await saved.hover(`#${id}`);
  await saved.keyboard.press("m");
  ok(await saved.$(".stack.max .maxed[data-panel]"), "the panel fills the page");
  await saved.keyboard.press("m");
  ok(!(await saved.$(".stack.max")), "and is restored");
  await saved.keyboard.press("?");
  const help = await saved.textContent("#help");
  ok(help.includes("Go to a time") && !help.includes("Annotate"), "only keys that work are listed");
  equal(requests, [saved.url()], "the file is all that the page loads");
});
