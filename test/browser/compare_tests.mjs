// Compares two recordings on one axis. The second one is shifted by a number, by dragging, and by an event in each.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, panelOf, pointAt, settled } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

// Returns the value of a stream that is drawn as a line, at a time of the page.
const value = (page, stream, t) =>
  page.evaluate(
    ([name, time]) => {
      const layer = [...window.situStudio.views].flatMap((v) => v.layers ?? []).find((l) => l.vis.stream === name);
      const { series } = layer.channel;
      return series.last[series.indexAt(time)];
    },
    [stream, t],
  );

const late = (page) =>
  page.evaluate(() => {
    const { offset, alignedStart: together } = window.situStudio.compare;
    return Number(offset - together) / 1e9;
  });

async function lateIs(page, seconds) {
  await until(
    page,
    (s) => {
      const { offset, alignedStart: together } = window.situStudio.compare;
      return Math.abs(Number(offset - together) / 1e9 - s) < 0.01 && !window.situStudio.client.inflight;
    },
    `it begins ${seconds} s later`,
    seconds,
  );
  await settled(page);
}

test("3 compare: a second recording is chosen, drawn next to the first, and shifted", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await page.keyboard.press("v");
  await until(page, () => document.querySelector("#compare-dialog select"), "the dialog");
  await page.selectOption("#compare-dialog select", "memory");
  await Promise.all([page.waitForURL(/with=memory/), page.click("#compare-dialog button[type=submit]")]);
  await until(page, () => document.body?.dataset.ready === "1" && window.situStudio.compare, "the comparison");
  await settled(page);
  equal(await panelOf(page, "Compared.Mic.Level"), await panelOf(page, "Mic.Level"), "lines share a panel");
  ok(
    (await panelOf(page, "Compared.Camera.Image")) !== (await panelOf(page, "Camera.Image")),
    "images do not share a panel",
  );
  near(await value(page, "Compared.Mic.Level", 20.2 * S), await value(page, "Mic.Level", 20.2 * S), 1e-9, "alike");
  await page.fill("#compare input", "2.5 s");
  await page.keyboard.press("Enter");
  await lateIs(page, 2.5);
  near(await value(page, "Compared.Mic.Level", 22.7 * S), await value(page, "Mic.Level", 20.2 * S), 1e-6, "shifted");
  // The image at the cursor is from the shifted time.
  await pointAt(page, await panelOf(page, "Vad.Speaking"), 30.2 * S);
  const shown = async (stream, at) => {
    const id = await panelOf(page, stream);
    await until(
      page,
      ([i, t]) => document.querySelector(`#${i} canvas`)?.dataset.at === String(t),
      `the image of ${stream}`,
      [id, at],
    );
  };
  await shown("Camera.Image", 30 * S);
  await shown("Compared.Camera.Image", 29.5 * S);
  await shot("compare");
  // Drags by a tenth of the view.
  const box = await page.locator("#compare .shift").boundingBox();
  const [a, b] = await page.evaluate(() => window.situStudio.time.get().view);
  const width = await page.evaluate(
    () => document.getElementById("navigator").clientWidth - window.situStudio.gutter.left - 14,
  );
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 - 30, box.y + box.height / 2);
  await page.mouse.up();
  await lateIs(page, 2.5 - (30 * (b - a)) / width / S);
  // A saved layout includes the shift, even if the shift changed in between.
  const saved = await late(page);
  await page.click("button[title='Save the layout']");
  await page.fill("#layout-save input[name=name]", "Both");
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("studio").dataset.layout === "Both", "the layout is saved");
  await page.fill("#compare input", "9 s");
  await page.keyboard.press("Enter");
  await lateIs(page, 9);
  await page.selectOption("#layout-pick select", "Automatic");
  await until(page, () => document.getElementById("studio").dataset.layout === "Automatic", "another layout");
  await page.selectOption("#layout-pick select", "Both");
  await lateIs(page, saved);
  // The address includes the shift and the layout of both.
  await until(page, () => new URLSearchParams(location.search).get("offset"), "the address includes it");
  await page.waitForTimeout(300);
  const before = await late(page);
  await page.reload();
  await until(page, () => document.body?.dataset.ready === "1" && window.situStudio.compare, "loaded again");
  near(await late(page), before, 1e-6, "shifted as before");
  await Promise.all([page.waitForURL((u) => !u.search.includes("with=")), page.click("[data-align=stop]")]);
  await until(page, () => document.body?.dataset.ready === "1", "alone again");
  ok(!(await page.$("#compare")), "nothing is compared");
});

test("3 compare: an event is chosen in each recording, and the two events are aligned", async ({ page }) => {
  await page.goto(`${main}/s/minute.0000?with=memory`);
  await until(page, () => document.body?.dataset.ready === "1" && window.situStudio.compare, "the comparison");
  await settled(page);
  // Someone speaks from 5 s to 10 s, from 15 s to 20 s, and so on. The second interval of the first recording is
  // aligned with the first interval of the second.
  const lanes = await panelOf(page, "Vad.Speaking");
  const row = async (stream) =>
    page.evaluate(
      ([id, name]) => {
        const view = [...window.situStudio.views].find((v) => v.el.id === id);
        return view.rows.findIndex((r) => r.l.vis.stream === name) * view.row + view.row / 2 + 4;
      },
      [lanes, stream],
    );
  const choose = async (stream, t, item) => {
    const { x } = await pointAt(page, lanes, t);
    const { y } = await page.locator(`#${lanes}`).boundingBox();
    await page.mouse.click(x, y + (await row(stream)), { button: "right" });
    await page.click(`#menu button:has-text("${item}")`);
  };
  await choose("Vad.Speaking", 17 * S, "a moment of minute.0000");
  ok((await page.textContent("#compare .marks")).includes("memory"), "it asks for the other event");
  await choose("Compared.Vad.Speaking", 7 * S, "a moment of memory");
  await lateIs(page, 10);
});
