// Work with time: statistics of a selection, found times, comments and exported files.
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
import { answer, colorOf, open, state, dispatch, panelOf } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

async function menu(page, id, item) {
  await page.click(`#${id}`, { button: "right" });
  await page.click(`#menu button:has-text("${item}")`);
}

test("3 work: statistics have a histogram whose bars count the messages", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "select", from: 5 * S, to: 10 * S });
  await menu(page, await panelOf(page, "Mic.Level"), "Statistics");
  await until(page, () => document.querySelector("#statistics figure svg"), "a histogram");
  const bars = await page.$$eval("#statistics figure:first-of-type rect title", (t) =>
    t.map((e) => Number(e.textContent)),
  );
  equal(
    bars.reduce((a, b) => a + b, 0),
    501,
    "messages of five seconds, both ends",
  );
  ok(Math.max(...bars) === bars.at(-1), "a sine is most often at its top");
  await shot("histogram");
});

test("3 work: times are found by an expression, visited, and made annotations", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await page.keyboard.press("f");
  await until(page, () => document.activeElement?.id === "query-text", "the field has the focus");
  await page.keyboard.type("`Vad.Speaking` and");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelector(".query .error"), "an invalid expression is rejected with an error");
  await page.fill("#query-text", "`Vad.Speaking`");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelectorAll(".found-times button").length === 6, "six times");
  ok((await page.textContent(".query [role=status]")).startsWith("6 times, "), "the number of times is shown");
  await page.click(".found-times button >> nth=1");
  await until(page, () => window.situStudio.time.get().sel[0] === 15e9, "the second is selected");
  const s = await state(page);
  equal(s.cursor, 15 * S, "the cursor is at its beginning");
  near(s.view[1] - s.view[0], 1.1 * (s.sel[1] - s.sel[0]), 1e6, "and it fills the view");
  await shot("query");
  await page.click(".query button:text('As annotations')");
  await until(
    page,
    () => window.situStudio.annotation?.state.items.filter((a) => a.proposed).length === 6,
    "six proposals",
  );
  await page.click(".query [aria-label='Close']");
  await until(page, () => !document.querySelector(".query"), "closed");
});

test("3 work: a comment stays with the recording", async ({ page, context }) => {
  await open(page, main, "uneven.0000");
  await dispatch(page, { type: "select", from: 12 * S, to: 18 * S });
  await page.keyboard.press("k");
  await answer(page, "somebody <b>comes</b> in");
  await until(
    page,
    () => window.situStudio.annotation?.state.items[0]?.values.Markers === "somebody <b>comes</b> in",
    "the comment is shown",
  );
  // A second comment at the same time has its own row.
  await dispatch(page, { type: "nudge", by: 15 * S - (await state(page)).cursor });
  await dispatch(page, { type: "clearSel" });
  await page.keyboard.press("k");
  await answer(page, "louder");
  await until(page, () => window.situStudio.annotation?.state.tracks.length === 2, "a second row");
  const other = await context.newPage();
  await open(other, main, "uneven.0000", "?annotate=Markers");
  await until(other, () => window.situStudio.annotation?.state.items.length === 2, "another page has both");
});

test("3 work: the selection is exported as CSV and as WAV", async ({ page }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "select", from: 5 * S, to: 6 * S });
  const take = async (stream, item) => {
    const id = await panelOf(page, stream);
    const [file] = await Promise.all([page.waitForEvent("download"), menu(page, id, item)]);
    return readFileSync(await file.path());
  };
  const rows = (await take("Mic.Level", "as CSV")).toString().trim().split("\r\n");
  equal(rows[0], "time_ns,time,stream,value", "its header");
  const level = rows.filter((r) => r.includes(",Mic.Level,"));
  equal(level.length, 101, "a hundred a second, both ends");
  equal(
    level[0].split(",").slice(0, 3),
    ["1767225605000000000", "2026-01-01T00:00:05.000000000Z", "Mic.Level"],
    "row",
  );
  const wav = await take("Mic.Audio", "as WAV");
  equal([wav.toString("latin1", 0, 4), wav.toString("latin1", 8, 12)], ["RIFF", "WAVE"], "a WAV");
  const rate = wav.readUInt32LE(24);
  equal(wav.length, 58 + 4 * rate, "a second of it");
});

test("3 work: the selection is exported as Parquet, a panel as SVG with lines and texts", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "select", from: 5 * S, to: 6 * S });
  const take = async (stream, item) => {
    const id = await panelOf(page, stream);
    const [file] = await Promise.all([page.waitForEvent("download"), menu(page, id, item)]);
    return readFileSync(await file.path());
  };
  const table = await take("Mic.Level", "as Parquet");
  equal([table.toString("latin1", 0, 4), table.toString("latin1", table.length - 4)], ["PAR1", "PAR1"], "Parquet");
  for (const name of ["originating_time", "creation_time", "stream", "value"])
    ok(table.includes(name), `it has a column ${name}`);
  // Checks that the drawing consists of separate elements.
  const elements = async (stream) => {
    const text = (await take(stream, "Save as SVG")).toString();
    return page.evaluate((svg) => {
      const doc = new DOMParser().parseFromString(svg, "image/svg+xml");
      const all = (tag) => [...doc.querySelectorAll(tag)];
      return {
        bad: all("parsererror").length,
        paths: all("path").map((p) => p.getAttribute("d").length),
        colors: all("path").map((p) => p.getAttribute("stroke") ?? p.getAttribute("fill")),
        texts: all("text").map((t) => t.textContent),
        images: all("image").length,
      };
    }, text);
  };
  const line = await elements("Mic.Level");
  equal([line.bad, line.images], [0, 0], "an SVG without pixels");
  ok(Math.max(...line.paths) > 2000, "its line is a path");
  ok(
    line.texts.some((t) => t.includes("Level")) && line.texts.some((t) => /^-?\d/.test(t)),
    "with names and numbers",
  );
  const color = await colorOf(page, "Mic.Level");
  const hex = "#" + color.map((c) => c.toString(16).padStart(2, "0")).join("");
  ok(line.colors.includes(hex), `the line has the colour of the stream: ${hex}`);
  const lanes = await elements("Vad.Speaking");
  ok(lanes.bad === 0 && lanes.images === 0 && lanes.paths.length > 6, "lanes are boxes");
  const picture = await elements("Camera.Image");
  equal([picture.bad, picture.images], [0, 1], "an image remains an image, at its position");
  await shot("svg");
});

test("3 work: the selection is exported as a video with audio and overlays", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "select", from: 5 * S, to: 8 * S });
  await menu(page, await panelOf(page, "Camera.Image"), "Video of the selection");
  await until(page, () => document.querySelector("#film-file"), "the video is written");
  await shot("film");
  ok((await page.textContent("#film")).includes("with audio and overlays"), "the dialog describes its contents");
  const [file] = await Promise.all([page.waitForEvent("download"), page.click("#film-file")]);
  const probe = ["-v", "error", "-show_entries", "stream=codec_name,codec_type:format=duration", "-of", "json"];
  const told = JSON.parse(execFileSync("ffprobe", [...probe, await file.path()]));
  equal(told.streams.map((s) => s.codec_name).sort(), ["aac", "h264"], "video and audio");
  near(Number(told.format.duration), 3, 0.15, "its duration is that of the selection");
  await page.click("#film button:text('Close')");
  await until(page, () => !document.querySelector("#film"), "closed");
  // An export of the entire minute is cancelled.
  await dispatch(page, { type: "clearSel" });
  await menu(page, await panelOf(page, "Camera.Image"), "Video of the view");
  await page.click("#film button");
  await until(page, () => !document.querySelector("#film"), "cancelled");
});
