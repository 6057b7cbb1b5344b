// Streams that are computed by expressions, and panels that plot numbers against each other, audio by frequency,
// and messages as a list.
import { test, equal, ok, near, until } from "./harness.mjs";
import { answer, open, settled, state, dispatch, panelIn } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

const menu = async (page, stream, item) => {
  await page.click(`#tree .node[data-stream='${stream}']`, { button: "right" });
  await page.click(`#menu button:has-text("${item}")`);
};

test("3 derived: an expression makes a stream, which a link and a reload preserve", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await page.keyboard.press("e");
  await answer(page, "`Mic.Level` * 2 +");
  await until(
    page,
    () => document.getElementById("toast").textContent.includes("invalid expression"),
    "rejected with an error",
  );
  await menu(page, "Mic.Level", "Derive from this stream…");
  await until(page, () => document.activeElement?.value === "`Mic.Level`", "its name is inserted");
  await answer(page, "`Mic.Level` * 10 + `Imu.Acc.Y`");
  const name = "= `Mic.Level` * 10 + `Imu.Acc.Y`";
  await until(
    page,
    (n) =>
      [...document.querySelectorAll("[phx-hook='Panel']")].some(
        (e) => JSON.parse(e.dataset.config).vis[0].stream === n,
      ),
    "it is drawn",
    name,
  );
  const check = async () => {
    await dispatch(page, { type: "view", from: 20 * S, to: 21 * S });
    await dispatch(page, { type: "cursor", t: 20.505 * S });
    await settled(page);
    const told = await page.evaluate(
      (n) =>
        [...document.querySelectorAll(".legend-item")].find((e) => e.dataset.stream === n)?.querySelector("b")
          .textContent,
      name,
    );
    near(
      Number(told),
      10 * Math.abs(Math.sin(20.5)) + 4 * Math.cos(10.25),
      2e-3,
      "its value is that of the expression",
    );
  };
  await check();
  await shot("derived");
  await until(page, () => new URLSearchParams(location.search).get("edit"), "the address includes it");
  await page.reload();
  await until(page, () => document.body?.dataset.ready === "1", "loaded again");
  await check();
  // States from an expression are drawn as lanes.
  await page.keyboard.press("e");
  await answer(page, "`Mic.Level` > 0.5");
  await until(
    page,
    () =>
      [...window.situStudio.views].some((v) =>
        v.rows?.some((r) => r.l.vis.stream === "= `Mic.Level` > 0.5" && r.l.channel.segments?.size),
      ),
    "booleans are drawn as a lane",
  );
});

test("3 XY: the second stream is plotted against the first, within the view", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await menu(page, "Imu.Acc.X", "Show as xy plot");
  await until(page, () => document.querySelector(".xy-cell"), "a panel");
  const id = panelIn(await page.$eval(".xy-cell", (e) => e.id));
  await page.evaluate((panel) => window.situStudio.options.push("add_stream", { stream: "Imu.Acc.Y", panel }), id);
  await until(page, () => [...window.situStudio.views].find((v) => v.windowed)?.dots > 100, "dots");
  await dispatch(page, { type: "view", from: 10 * S, to: 12 * S });
  await until(
    page,
    () => [...window.situStudio.views].find((v) => v.windowed).dots === 201,
    "the messages of the view",
  );
  const seen = await page.evaluate(() => {
    const v = [...window.situStudio.views].find((w) => w.windowed);
    return v.dotClouds()[0].dots.map(([t, x, y]) => [x - 9.8 * Math.sin(t / 3e9), y - 4 * Math.cos(t / 2e9)]);
  });
  ok(
    seen.every(([a, b]) => Math.abs(a) < 1e-9 && Math.abs(b) < 1e-9),
    "each dot is a value of x and one of y of the same time",
  );
  await dispatch(page, { type: "cursor", t: 11 * S });
  await settled(page);
  await shot("xy");
});

test("3 spectrogram: a tone is at its frequency while it sounds", async ({ page, shot }) => {
  // The same minute without the annotations of other tests, which make the panels lower.
  await page.setViewportSize({ width: 1280, height: 1100 });
  await open(page, main, "memory");
  await menu(page, "Mic.Audio", "Show as spectrogram");
  await until(
    page,
    () =>
      [...window.situStudio.views].some((v) =>
        v.layers?.some((l) => l.vis.draw === "spectrogram" && l.spectra?.length > 100),
      ),
    "columns",
  );
  const id = await page.evaluate(
    () => [...window.situStudio.views].find((v) => v.layers?.[0]?.vis.draw === "spectrogram").el.id,
  );
  await page.$eval(`#${id}`, (e) => e.scrollIntoView());
  const told = async (t) => {
    await dispatch(page, { type: "cursor", t });
    await settled(page);
    return page.$eval(`#${id} .legend-item b`, (e) => e.textContent);
  };
  near(parseFloat((await told(2.5 * S)).replace("loudest ", "")), 440, 20, "the tone");
  ok(!/^loudest \S+ Hz$/.test(await told(1.7 * S)), "nothing is loudest in a silent second");
  const colors = await page.evaluate((i) => {
    const v = [...window.situStudio.views].find((w) => w.el.id === i);
    const { ctx, bbox } = v.plot;
    const at = (t, hz) => {
      const view = window.situStudio.time.get().view;
      const x = bbox.left + ((t * 1e9 - view[0]) / (view[1] - view[0])) * bbox.width;
      const y = bbox.top + bbox.height - ((hz - v.y[0]) / (v.y[1] - v.y[0])) * bbox.height;
      return [...ctx.getImageData(Math.round(x), Math.round(y), 1, 1).data];
    };
    return { tone: at(2.5, 440), above: at(2.5, 6000), silent: at(1.5, 440) };
  }, id);
  const light = ([r, g, b]) => r + g + b;
  ok(light(colors.tone) > 300, `the tone is bright: ${colors.tone}`);
  ok(light(colors.above) < light(colors.tone) / 2, `silent frequencies are dark: ${colors.above}`);
  ok(light(colors.silent) < light(colors.tone) / 2, `silence is dark: ${colors.silent}`);
  await shot("spectrogram");
});

test("3 list: shows the messages around the cursor; a click goes to a message", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await menu(page, "Speech.Text", "Show as list");
  await dispatch(page, { type: "cursor", t: 30.5 * S });
  await until(
    page,
    () => document.querySelector(".log-cell [aria-current] .v")?.textContent === "word 30",
    "the message at the cursor is marked",
  );
  const rows = await page.$$eval(".log-cell li .v", (r) => r.map((e) => e.textContent));
  equal([rows[0], rows.at(-1), rows.length], ["word 0", "word 59", 60], "the messages around it");
  await shot("list");
  await page.click(".log-cell li:has-text('word 33')");
  await until(page, () => window.situStudio.time.get().cursor === 33e9, "the cursor goes to it");
  await page.focus(".log-cell ol");
  await page.keyboard.press("ArrowUp");
  await until(page, () => window.situStudio.time.get().cursor === 32e9, "a key goes to the previous message");
  equal((await state(page)).mode, "manual", "nothing plays");
});
