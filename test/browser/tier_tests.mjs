// Tiers with parents, segmentation by one key during playback, and transcription with the keyboard alone.
import { test, equal, ok, until } from "./harness.mjs";
import { dispatch, open, state, typeNewAnnotations } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

const items = (page, track) =>
  page.evaluate(
    (t) =>
      window.situStudio.annotation.state.items
        .filter((a) => a.track === t)
        .sort((a, b) => a.from - b.from)
        .map((a) => [a.from, a.to, Object.values(a.values)[0]]),
    track,
  );

const count = (page, n, what) => until(page, (k) => window.situStudio.annotation.state.items.length === k, what, n);

async function beginTiers(page, name, text) {
  await page.keyboard.press("a");
  await page.selectOption("#annotation-new select[name=kind]", "tiers");
  await page.fill("#annotation-new input[name=name]", name);
  await page.fill("#annotation-new textarea", text);
  await page.click("#annotation-new .primary");
  await until(page, () => window.situStudio.annotation?.state.tiers.length > 0, "the tiers are shown");
}

test("11 tiers: utterances are segmented by one key while playing, and transcribed row by row", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  await beginTiers(page, "Talk", "Utterance\nWords in Utterance\nEnglish of Utterance");
  equal(
    await page.evaluate(() => window.situStudio.annotation.trackNames()),
    ["Utterance", "Words", "English"],
    "children follow their parent",
  );
  await page.focus("#annotation-body");
  await page.keyboard.press("g");
  await page.keyboard.press("g");
  await page.keyboard.press("Space");
  await until(page, () => window.situStudio.time.get().mode === "play", "plays");
  for (let i = 0; i <= 3; i++) {
    const { cursor } = await state(page);
    await page.keyboard.press("Enter");
    await until(page, (c) => window.situStudio.time.get().cursor > c + 2e8, "the cursor moves on", cursor);
  }
  await page.keyboard.press("Space");
  await count(page, 3, "three utterances");
  const made = await items(page, "Utterance");
  equal(made[0][1], made[1][0], "without a gap");
  await page.keyboard.press("Escape");
  await page.keyboard.press("Escape");

  // each row is played in a loop while its text is typed
  await page.focus("#annotation-body");
  await page.evaluate(() => {
    window.situStudio.annotation.track = "English";
  });
  await dispatch(page, { type: "nudge", by: -60 * S });
  await page.keyboard.press("T");
  await until(page, () => document.querySelectorAll(".transcription input").length === 3, "three rows");
  for (const text of ["first", "second", "third"]) {
    await page.keyboard.type(text);
    const { sel, mode, repeat } = await state(page);
    equal([mode, repeat], ["play", true], "the row is played in a loop");
    ok(
      made.some(([from, to]) => from === sel[0] && to === sel[1]),
      "which is its utterance",
    );
    await page.keyboard.press("Enter");
  }
  await count(page, 6, "three texts");
  await page.keyboard.press("Shift+Enter");
  await page.keyboard.press("Control+a");
  await page.keyboard.type("2nd");
  await shot("transcription");
  await page.keyboard.press("Escape");
  await until(
    page,
    () => window.situStudio.annotation.state.items.some((a) => a.values.English === "2nd"),
    "the text was corrected",
  );
  equal(
    (await items(page, "English")).map((a) => a[2]),
    ["first", "2nd", "third"],
    "the texts",
  );

  // deleting an utterance deletes its translation, in one step
  await page.evaluate(() => {
    const { annotation } = window.situStudio;
    annotation.selected = annotation.state.items.find((a) => a.track === "Utterance").id;
  });
  await page.keyboard.press("Delete");
  await count(page, 4, "the utterance and its text are deleted");
  await page.keyboard.press("Control+z");
  await count(page, 6, "both are back");
});

test("11 tiers: the layers of all annotators are below each other, and their consensus is reviewed", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  const add = async (from, to) => {
    await dispatch(page, { type: "select", from: from * S, to: to * S });
    await page.focus("#annotation-body");
    await page.keyboard.press("Enter");
  };
  await typeNewAnnotations(page, "Turn");
  await until(page, () => window.situStudio.annotation?.state.stream === "Turn", "the first layer");
  await add(10, 20);
  await add(40, 50);
  await count(page, 2, "two annotations");
  await page.click(".annotation-tools button:text('×')");
  await until(page, () => !document.getElementById("annotation-body"), "closed");
  await page.keyboard.press("a");
  await page.selectOption("#annotation-own select", "Turn");
  await page.fill("#annotation-own input", "Ben");
  await page.click("#annotation-own button");
  await until(page, () => window.situStudio.annotation?.state.stream === "Turn.Ben", "another layer");
  await add(12, 20);
  await count(page, 1, "one annotation");
  await page.click(".annotation-tools button:text('All annotators')");
  await until(page, () => window.situStudio.annotation.merged.data.segments.length === 3, "three segments");
  equal(
    await page.evaluate(() => window.situStudio.annotation.merged.data.segments.map((s) => s.agree)),
    [false, true, false],
    "where they agree",
  );
  ok(
    (await page.textContent(".annotation-tools")).includes("2 disagreements"),
    "the number of disagreements is shown",
  );
  await dispatch(page, { type: "nudge", by: -60 * S });
  await page.focus("#annotation-body");
  await page.keyboard.press("d");
  await page.keyboard.press("d");
  equal((await state(page)).sel, [40 * S, 50 * S], "the second disagreement is selected");
  await shot("merged");
  await page.click(".annotation-tools button:text('Consensus')");
  await until(page, () => window.situStudio.annotation?.state.stream === "Turn.consensus", "the consensus");
  const proposed = await page.evaluate(() =>
    window.situStudio.annotation.state.items.map((a) => [a.from / 1e9, a.to / 1e9, a.proposed]),
  );
  equal(
    proposed,
    [
      [10, 12, true],
      [12, 20, false],
      [40, 50, true],
    ],
    "disagreements are proposals",
  );
});

test("11 tiers: are added, renamed, moved and removed in the dialog, and annotations follow", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  await beginTiers(page, "Chat", "Utterance\nWords in Utterance");
  await page.evaluate(() =>
    window.situStudio.annotation.addAnnotation(10e9, 20e9, { Utterance: "hello you" }, "Utterance"),
  );
  await count(page, 1, "an utterance");
  await page.click(".annotation-tools button:text('Tiers…')");
  const line = async (text) => {
    await page.fill("[data-form=tier-add] input", text);
    await page.click("[data-form=tier-add] button");
  };
  const names = (list, what) =>
    until(
      page,
      (want) => want === [...document.querySelectorAll(".tier-row input[name=name]")].map((i) => i.value).join(),
      what,
      list,
    );
  await line("Kind of Utterance: question, answer");
  await names("Utterance,Words,Kind", "a tier is added");
  await page.click("button[aria-label='Move Kind up']");
  await names("Utterance,Kind,Words", "it is moved");
  await page.fill("input[aria-label='Name of Utterance']", "Turn");
  await page.click("button[aria-label='Change Utterance']");
  await names("Turn,Kind,Words", "a tier is renamed");
  await until(page, () => window.situStudio.annotation.state.items[0].track === "Turn", "with its annotation");
  equal((await items(page, "Turn"))[0][2], "hello you", "and its text");
  await page.click("button[aria-label='Remove Turn']");
  await until(page, () => document.querySelector("#tier-dialog .error").textContent.includes("1 annotation"), "asks");
  await shot("tiers");
  await page.click("#tier-dialog button:text('Remove Turn, 2 tiers below it, and 1 annotation')");
  await names("", "all tiers are removed");
  await page.click("#tier-dialog button:text('Undo')");
  await names("Turn,Kind,Words", "undo brings them back");
  await count(page, 1, "with the annotation");
  await page.click("#tier-dialog button:text('Close')");
  equal(
    await page.evaluate(() => window.situStudio.annotation.trackNames()),
    ["Turn", "Kind", "Words"],
    "in this order",
  );
});
