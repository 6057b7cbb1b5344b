// Checks the accessibility of every screen with axe-core.
import { test, equal, until } from "./harness.mjs";
import { objections } from "./axe.mjs";
import { answer, open, dispatch, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);

test("axe: every canvas has a text alternative", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.click("#tree .node[data-stream='Speech.Scores'] .name");
  await page.click("button[phx-value-viz='bars']");
  await until(
    page,
    () => {
      const labels = [...document.querySelectorAll("[data-panel] canvas")].map((c) => c.getAttribute("aria-label"));
      return labels.length > 5 && labels.every((l) => / of \S/.test(l ?? ""));
    },
    "all have a text alternative",
  );
  await dispatch(page, { type: "view", from: 10e9, to: 20e9 });
  await until(
    page,
    () =>
      document.querySelector(
        "canvas[aria-label^='Lanes of Vad.Speaking, '][aria-label$=' from 0:10.000 to 0:20.000']",
      ),
    "which follows the view",
  );
});

const screens = {
  home: (page) => page.goto(main),
  recording: (page) => open(page, main, "minute.0000"),
  "properties of a stream": async (page) => {
    await open(page, main, "minute.0000");
    await page.click("#tree .node[data-stream='Mic.Level'] .name");
    await until(page, () => document.querySelector(".right h2"), "properties");
  },
  "properties of a panel": async (page) => {
    await open(page, main, "minute.0000");
    await page.click("[data-panel] button.title >> nth=0");
    await until(page, () => document.querySelector(".right h2"), "properties");
  },
  session: (page) => open(page, main, "study.json/p02"),
  live: (page) => open(page, main, "Lobby"),
  comparison: async (page) => {
    await open(page, main, "minute.0000", "?with=memory");
    await until(page, () => window.situStudio.compare, "the comparison");
  },
  dataset: async (page) => {
    await page.goto(`${main}/d/study.json`);
    await until(page, () => document.querySelectorAll("#tree .session img").length === 2, "its recordings are known");
  },
  "batch dialog": async (page) => {
    await screens.dataset(page);
    await page.click("#tree .node.dataset", { button: "right" });
    await page.click('#menu button:has-text("Run loudness…")');
    await until(page, () => document.querySelector("#task"), "the dialog");
  },
  // Opens each dialog of the tree's menus.
  "dataset dialogs": async (page) => {
    await screens.dataset(page);
    await page.click("#tree .session .fold");
    for (const [row, item, dialog] of [
      ["dataset", "Add each subfolder of a folder", "#folders"],
      ["partition", "Use another recording", "#relocate"],
      ["partition", "Save a section as", "#part"],
    ]) {
      await page.click(`#tree .node.${row} .name`, { button: "right" });
      equal(await objections(page), [], "objections to the menu");
      await page.click(`#menu button:has-text("${item}")`);
      await until(page, (d) => document.querySelector(d)?.open, "the dialog", dialog);
      equal(await objections(page), [], `objections to ${dialog}`);
      if (dialog !== "#part") await page.keyboard.press("Escape");
      await until(page, (d) => d === "#part" || !document.querySelector(d), "it is closed", dialog);
    }
  },
  "menu of annotations": async (page) => {
    await screens.annotations(page);
    await page.focus("#annotation-body");
    await page.keyboard.press("Shift+F10");
    await until(page, () => !document.getElementById("menu").hidden, "the menu");
  },
  "schema dialog": async (page) => {
    await screens.annotations(page);
    await page.click(".annotation-tools button:text('Schema…')");
    await until(page, () => document.querySelector("#schema-dialog")?.open, "the dialog");
  },
  proposals: async (page) => {
    await screens.annotations(page);
    await page.evaluate(() => window.situStudio.options.push("annotation_propose", { stream: "Vad.Speaking" }));
    await until(page, () => window.situStudio.annotation.state.items.some((a) => a.proposed), "proposals");
  },
  "annotation dialog": async (page) => {
    await open(page, main, "minute.0000");
    await page.keyboard.press("a");
    await until(page, () => document.querySelector("#annotation-dialog"), "the dialog");
  },
  annotations: async (page) => {
    await open(page, main, "minute.0000");
    await dispatch(page, { type: "select", from: 1e9, to: 2e9 });
    await page.keyboard.press("k");
    await answer(page, "here");
    await until(page, () => window.situStudio.annotation?.state.items.length, "a comment");
  },
  film: async (page) => {
    await open(page, main, "minute.0000");
    await dispatch(page, { type: "select", from: 1e9, to: 2e9 });
    await page.click(`#${await panelOf(page, "Camera.Image")} canvas`, { button: "right" });
    await page.click("#menu button:has-text('Video of the selection')");
    await until(page, () => document.querySelector("#film-file"), "the video");
  },
  trace: async (page) => {
    await screens.graph(page);
    await page.click(".graph .edge.lossy .number");
    await until(page, () => document.querySelectorAll(".messages button.linkish").length === 8, "its last messages");
    // The list changes continuously, so the test clicks a position, not a message.
    await page.evaluate(() => document.querySelector(".messages button.linkish").click());
    await until(
      page,
      () => document.querySelectorAll("#trace .hops li").length >= 3,
      "the path of its originating time",
    );
  },
  find: async (page) => {
    await open(page, main, "minute.0000");
    await page.keyboard.press("f");
    await until(page, () => document.querySelector(".query"), "the panel");
  },
  graph: async (page) => {
    await page.goto(`${main}/p/Factory`);
    await until(page, () => document.querySelector(".graph .node"), "the graph");
  },
  settings: async (page) => {
    await page.goto(`${main}/settings`);
    await until(page, () => document.querySelectorAll(".settings .keys .btn").length > 40, "the keys");
  },
  question: async (page) => {
    await open(page, main, "minute.0000");
    await page.keyboard.press("k");
    await until(page, () => document.querySelector("#question"), "the question");
  },
  keys: async (page) => {
    await open(page, main, "minute.0000");
    await page.keyboard.press("?");
  },
  sensor: async (page) => {
    await page.goto(`${main}/sensor?name=browser`);
    await until(page, () => document.querySelector("#camera option"), "the cameras");
  },
  missing: (page) => page.goto(`${main}/s/nothing`),
};

for (const [name, show] of Object.entries(screens))
  test(`axe: ${name}`, async ({ page }) => {
    await show(page);
    for (const theme of ["dark", "light"]) {
      await page.evaluate((t) => (document.documentElement.dataset.theme = t), theme);
      equal(await objections(page), [], `objections, ${theme}`);
    }
  });
