// Datasets in the page: the tree and its menus, metadata and search, sessions on one time axis, and batch runs.
import { existsSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { answer as confirm, open, state } from "./studio_page.mjs";

const { main, folder } = JSON.parse(process.argv[2]);
const file = `${folder}/study.json`;
const saved = () => JSON.parse(readFileSync(file, "utf8"));
const session = (name) => saved().sessions.find((s) => s.name === name);
const labels = (page) => page.$$eval("#tree .node .name", (n) => n.map((e) => e.textContent));
const row = (name) => `#tree .node:has(.name:text-is("${name}"))`;

const connected = (page) =>
  until(page, () => document.querySelector("[data-phx-main].phx-connected"), "the page is connected");

async function dataset(page) {
  await page.goto(`${main}/d/study.json`);
  await connected(page);
  await until(
    page,
    () => ![...document.querySelectorAll("#tree .session .info")].some((e) => e.textContent === "…"),
    "the recordings are known",
  );
}

async function menu(page, name, item) {
  await page.click(row(name), { button: "right" });
  await page.click(`#menu button:has-text("${item}")`);
}

async function answer(page, text) {
  await until(page, () => document.activeElement?.matches("#ask input"), "the dialog has the focus");
  await page.keyboard.type(text);
  await page.keyboard.press("Enter");
}

// Waits for a condition on files.
async function onDisk(probe, what) {
  for (const end = Date.now() + 30_000; Date.now() < end; await new Promise((r) => setTimeout(r, 50)))
    if (probe()) return;
  throw new Error(`timed out waiting until ${what}`);
}

// Returns a function that restores the dataset and the folder. All tests use them, also those after a failed one.
function restoreLater() {
  const before = readFileSync(file, "utf8");
  return () => {
    writeFileSync(file, before);
    for (const made of ["a copy.json", "ten seconds.0000"])
      rmSync(`${folder}/${made}`, { recursive: true, force: true });
  };
}

test("6 datasets: the tree shows sessions, recordings and streams; search covers all their texts", async ({
  page,
  shot,
}) => {
  await page.goto(main);
  await page.click(".home .item:has-text('study.json')");
  await until(page, () => location.pathname === "/d/study.json", "the list has a link to it");
  await dataset(page);
  equal(await labels(page), ["Lobby study", "p01", "p02", "p03"], "sessions");
  await until(
    page,
    () => document.querySelector("#tree .session .info")?.textContent === "1 min 0 s",
    "a session shows its duration",
  );
  ok((await page.textContent(row("p03"))).includes("cannot be opened"), "a missing recording is reported");
  await until(
    page,
    () => [...document.querySelectorAll("#tree img.thumb")].every((i) => i.complete && i.naturalWidth > 10),
    "sessions have images",
  );
  await page.click(`${row("p02")} .fold`);
  await until(page, () => document.querySelectorAll("#tree .partition").length === 2, "its recordings");
  await page.click(`${row("Wearable")} .fold`);
  await until(page, () => document.querySelectorAll("#tree .stream").length === 3, "their streams");
  await page.click(`${row("Late")} .name`);
  await until(
    page,
    () => document.querySelector(".dataset-side h2:last-of-type")?.textContent === "Late",
    "a stream's properties",
  );
  ok((await page.textContent(".dataset-side dl")).includes("401"), "with its messages");
  await shot("dataset");
  for (const [words, found] of [
    ["wearable late", ["p02"]],
    ["pilot", ["p01"]],
    ["nowhere", []],
  ]) {
    await page.fill("#search", words);
    await until(
      page,
      (names) => [...document.querySelectorAll("#tree .session .name")].map((e) => e.textContent).join() === names,
      `${words} finds ${found}`,
      found.join(),
    );
  }
});

test("6 datasets: sessions are created, renamed, filled and removed; metadata and tags are kept", async ({
  page,
  cleanUp,
}) => {
  cleanUp(restoreLater());
  await dataset(page);
  await menu(page, "Lobby study", "New session…");
  await answer(page, "p04");
  await until(page, () => document.querySelectorAll("#tree .session").length === 4, "a fourth session");
  await menu(page, "p04", "Add recordings…");
  await page.check("#recordings-form label:has-text('big.0000') input");
  await page.click("#recordings-form button[type=submit]");
  await onDisk(() => session("p04")?.partitions.length === 1, "its recording is in the file");
  await menu(page, "p04", "Rename…");
  await answer(page, "p04 late");
  await onDisk(() => session("p04 late"), "the new name is in the file");
  await page.click(`${row("p04 late")} .name`);
  await until(
    page,
    () => document.querySelector(".dataset-side .props h2")?.textContent === "p04 late",
    "its properties",
  );
  await page.fill(".metadata input[name=tags]", "late, german");
  await page.fill(".metadata textarea", "participant: P04\nage: 31");
  await page.click(".metadata button[type=submit]");
  await onDisk(() => session("p04 late").metadata?.age === 31, "metadata is in the file");
  equal(session("p04 late").tags, ["late", "german"], "the tags are shown");
  await page.fill("#search", "german p04");
  await until(page, () => document.querySelectorAll("#tree .session").length === 1, "found by tag and metadata");
  await page.fill(".metadata textarea", "no value here");
  await page.click(".metadata button[type=submit]");
  await until(
    page,
    () => document.getElementById("toast").textContent.includes("line 1"),
    "invalid metadata is rejected with an error",
  );
  await page.fill("#search", "");
  // Edits the file outside the studio.
  const now = saved();
  now.sessions[0].tags.push("by hand");
  writeFileSync(file, JSON.stringify(now, null, 2));
  await until(
    page,
    () => [...document.querySelectorAll("#tree .tag")].some((e) => e.textContent === "by hand"),
    "the external edit is shown",
  );
  await menu(page, "p04 late", "Remove from the dataset");
  await confirm(page);
  await onDisk(() => !session("p04 late"), "it is out of the file");
  ok(existsSync(`${folder}/big.0000`), "its recording is still there");
  equal(session("p01").tags, ["pilot", "by hand"], "the external edit is kept");
});

test("6 datasets: the history lists edits, undoes the last one, and restores a version", async ({
  page,
  shot,
  cleanUp,
}) => {
  cleanUp(restoreLater());
  await dataset(page);
  await menu(page, "p01", "Rename…");
  await answer(page, " first");
  await onDisk(() => !session("p01"), "the new name is in the file");
  const renamed = saved().sessions[0].name;
  await page.click("button:has-text('History…')");
  const newest = (text) =>
    until(
      page,
      (t) => document.querySelector("#history tbody tr td:nth-child(4)")?.textContent === t,
      `the newest edit: ${text}`,
      text,
    );
  await newest(`rename session p01 to ${renamed}`);
  await shot("history");
  const version = Number(await page.textContent("#history tbody tr td"));
  await page.click("button:has-text('Undo my last edit')");
  await onDisk(() => session("p01"), "the edit is undone");
  await page.click("button:has-text('History…')");
  await newest(`undo ${version}`);
  await page.click(`#history button[aria-label="Restore version ${version}"]`);
  await onDisk(() => session(renamed), "the version is restored");
});

test("6 datasets: a dialog keeps what was entered while the page changes", async ({ page, cleanUp }) => {
  cleanUp(restoreLater());
  await dataset(page);
  await menu(page, "p01", "Unfold all below");
  await menu(page, "Room", "Save a section as a recording…");
  await page.fill("#part [name=name]", "ten seconds");
  await page.fill("#part [name=to]", "10");
  // Edits the file outside the studio, so that the page changes while the dialog is open.
  const now = saved();
  now.sessions[0].tags.push("meanwhile");
  writeFileSync(file, JSON.stringify(now, null, 2));
  await until(
    page,
    () => [...document.querySelectorAll("#tree .tag")].some((e) => e.textContent === "meanwhile"),
    "the external edit is shown",
  );
  equal(
    await page.$$eval("#part input", (inputs) => inputs.map((e) => e.value)),
    ["ten seconds", "0", "10"],
    "the dialog's fields",
  );
});

test("6 datasets: a moved recording is found again, a section is saved, a copy of the dataset is opened", async ({
  page,
  shot,
  cleanUp,
}) => {
  cleanUp(restoreLater());
  await dataset(page);
  await page.selectOption(".pick select", "bytes_per_hour");
  await until(
    page,
    () => /\d MB\/h$/.test(document.querySelector("#tree .dataset .info").textContent),
    "any statistic next to the names",
  );
  await page.selectOption(".pick select", "began");
  await until(
    page,
    () => document.querySelector("#tree .session .info").textContent === "2026-01-01 00:00:00 UTC",
    "times show their time zone",
  );
  await menu(page, "p03", "Unfold all below");
  await menu(page, "Room", "Use another recording…");
  await page.check("#relocate label:has-text('many.0000') input");
  await page.click("#relocate button[type=submit]");
  await onDisk(() => session("p03").partitions[0].path === "many.0000", "the other place is in the file");
  await until(page, () => !document.querySelector("#tree .trouble"), "no recording is missing");
  await menu(page, "Room", "Save a section as a recording…");
  await page.fill("#part [name=name]", "ten seconds");
  await page.fill("#part [name=to]", "10");
  await shot("part");
  await page.click("#part button[type=submit]");
  await onDisk(() => existsSync(`${folder}/ten seconds.0000`), "the part is a recording");
  await menu(page, "Lobby study", "Save a copy as…");
  await answer(page, "a copy");
  await until(page, () => location.pathname === "/d/a%20copy.json", "the copy is opened");
  await connected(page);
  await menu(page, "Lobby study", "Add a folder as one session…");
  await page.check("#folders label:has-text('own folder') input");
  await page.click("#folders button[type=submit]");
  await until(
    page,
    () => /^1 session added|recordings added/.test(document.getElementById("toast").textContent),
    "said",
  );
  const copy = () => JSON.parse(readFileSync(`${folder}/a copy.json`, "utf8"));
  const copied = copy();
  ok(copied.sessions[3].partitions.length > 5, "with everything that was missing in it");
  await menu(page, copied.sessions[3].name, "Remove from the dataset");
  await confirm(page);
  await onDisk(() => copy().sessions.length === 3, "the session is out of the copy");
});

test("6 datasets: a session of two recordings is shown on one time axis", async ({ page, shot }) => {
  await open(page, main, "study.json/p02");
  const { data } = await state(page);
  equal(data[1] - data[0], 60e9, "its duration includes both recordings");
  ok(await page.$("#tree .node[data-stream='Wearable.Late']"), "streams of the first recording");
  ok(await page.$("#tree .node[data-stream='Room.Camera.Image']"), "streams of the second recording");
  await until(
    page,
    () => document.querySelector(".image-cell canvas")?.dataset.at,
    "the image of the first recording",
  );
  equal(await page.$$eval(".store", (s) => s.map((e) => e.title)), ["Lobby study", "p01", "p02", "p03"], "sessions");
  await shot("session");
  await page.goto(`${main}/s/study.json/p03`);
  await until(page, () => document.querySelector(".message h1"), "a recording that cannot be opened is reported");
});

test("6 batch: a task has a form, progress, results and errors", async ({ page, shot }) => {
  await dataset(page);
  await menu(page, "Lobby study", "Run loudness…");
  await page.fill("#option-gain", "fast");
  await page.click("#task button[type=submit]");
  await until(
    page,
    () => document.querySelector("#task .error")?.textContent.includes("gain must be a number"),
    "an invalid option is rejected with an error",
  );
  await page.fill("#option-gain", "3");
  await page.selectOption("#option-scale", "decibel");
  await page.fill("#task-keep", "three times");
  await shot("batch-form");
  await page.click("#task button[type=submit]");
  await until(page, () => document.querySelector(".run.failed"), "the run is over");
  const text = await page.textContent(".run");
  ok(text.includes("2 of 3 sessions") && text.includes("1 failed"), text);
  ok((await page.textContent(".failures")).includes("p03"), "the session that failed is named");
  for (const name of ["p01", "p02"])
    ok(
      session(name).partitions.some((p) => p.name === "Loudness"),
      `${name} has its output`,
    );
  await until(
    page,
    () =>
      [...document.querySelectorAll("#tree .node")].length > 0 &&
      !document.querySelector("#tree .info:empty.pending"),
    "the tree is shown",
  );
  await shot("batch");
  await menu(page, "p01", "Run loudness…");
  await page.selectOption("#task-saved select", "three times");
  await until(page, () => document.getElementById("option-gain")?.value === "3", "saved options");
});

test("6 batch: a run shows its progress, continues without the page, and is cancelled", async ({ page, shot }) => {
  writeFileSync(`${folder}/hold`, "");
  await dataset(page);
  await menu(page, "p02", "Run loudness…");
  await page.check("#option-hold");
  await page.fill("#task-output", "Held");
  await page.click("#task button[type=submit]");
  await until(page, () => document.querySelector(".run.running progress"), "it is running");
  await page.reload();
  // Before that, the page is not connected and cannot take a click.
  await connected(page);
  await until(page, () => document.querySelector(".run.running"), "it continues without the page");
  ok(/\d+ %, 0 of 1 sessions/.test(await page.textContent(".run.running")), "its progress is shown");
  await shot("batch-running");
  await page.click(".run.running button:has-text('Cancel')");
  rmSync(`${folder}/hold`);
  await until(page, () => document.querySelector(".run.cancelled"), "it is cancelled");
  ok(!session("p02").partitions.some((p) => p.name === "Held"), "no partial output remains");
});

test("6 datasets: a search over all sessions lists times, and a click opens the session there", async ({
  page,
  shot,
}) => {
  await dataset(page);
  await page.click(".topbar button:text('Find times')");
  await page.fill("#session-search textarea", "`Vad.Speaking` >");
  await page.click("#session-search .primary");
  await until(page, () => document.querySelector("#session-search .error"), "an error is explained");
  await page.fill("#session-search textarea", "`Vad.Speaking`");
  await page.fill("#session-search input[name=least]", "200ms");
  await page.click("#session-search .primary");
  await until(page, () => document.querySelectorAll("#session-search a.hit").length > 1, "times are listed");
  await until(page, () => !document.querySelector("#session-search [phx-click=find_stop]"), "the search has ended");
  await shot("session-search");
  const hit = await page.$("#session-search a.hit");
  const [from, to] = new URL(await hit.evaluate((a) => a.href)).searchParams.get("sel").split("~").map(BigInt);
  ok(to - from >= 200_000_000n, "short times are left out");
  await hit.click();
  await until(page, () => window.situStudio?.time.get().sel[0] != null, "the session is opened at the time");
  const shown = await page.evaluate(() => {
    const { client, time } = window.situStudio;
    return time.get().sel.map((t) => client.toAbsolute(t));
  });
  equal(
    shown.map((t) => Number(BigInt(t) - from) / 1e6).map(Math.round),
    [0, Math.round(Number(to - from) / 1e6)],
    "selected",
  );
});
