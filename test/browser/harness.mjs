// A minimal test runner: runs tests in order, each in a new page, and prints failures and a closing line.
import { chromium } from "playwright-core";
import { mkdirSync } from "node:fs";
import { join } from "node:path";

// The maximum duration of a step in ms. It is much longer than a step needs, even on a busy machine, and only a
// failing test waits that long.
export const PATIENCE = 120_000;

const tests = [];
export const test = (name, run) => tests.push({ name, run });

export function equal(actual, expected, what) {
  const a = JSON.stringify(actual),
    e = JSON.stringify(expected);
  if (a !== e) throw new Error(`${what}: expected ${e}, got ${a}`);
}

export function ok(value, what) {
  if (!value) throw new Error(what);
}

export function near(actual, expected, by, what) {
  if (!(Math.abs(actual - expected) <= by))
    throw new Error(`${what}: expected ${expected} within ${by}, got ${actual}`);
}

// Waits until `probe` is true in the page, and returns a handle of its value. The page evaluates it every 30 ms, or
// once per animation frame ("raf").
export async function until(page, probe, what, arg, polling = 30) {
  try {
    return await page.waitForFunction(probe, arg, { timeout: PATIENCE, polling });
  } catch (error) {
    throw new Error(`timed out waiting until ${what}: ${error.message.split("\n")[0]} at ${page.url()}`);
  }
}

// Makes navigation wait until the page is connected, since a loaded page cannot take clicks before. Pages that are
// not LiveViews (an error, the sensor's page) do not connect.
function patient(page) {
  for (const name of ["goto", "reload"]) {
    const plain = page[name].bind(page);
    page[name] = async (...args) => {
      const response = await plain(...args);
      await until(
        page,
        () => {
          const views = document.querySelectorAll("[data-phx-main]");
          return [...views].every((v) => v.classList.contains("phx-connected"));
        },
        "the page is connected",
      );
      return response;
    };
  }
  return page;
}

export async function runAll({ filter = "", times = 1, shots }) {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
    args: [
      "--no-sandbox",
      // There may be no graphics card, so WebGL is rendered in software.
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
      // 2D content is painted in software as well, because the emulated GPU would take three times as long.
      "--disable-gpu-compositing",
      "--disable-gpu-rasterization",
      "--disable-accelerated-2d-canvas",
      "--disable-quic",
      // Chromium simulates a camera and a microphone without asking for permission.
      "--use-fake-device-for-media-stream",
      "--use-fake-ui-for-media-stream",
      "--no-first-run",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      "--autoplay-policy=no-user-gesture-required",
    ],
  });
  const plain = browser.newContext.bind(browser);
  browser.newContext = async (options) => {
    const context = await plain(options);
    context.setDefaultTimeout(PATIENCE);
    await hideHints(context);
    return context;
  };
  const words = filter.split("|");
  const wanted = tests.filter(({ name }) => words.some((w) => name.includes(w)));
  // Runs one test in a new context, and then the functions that it gave to `cleanUp`. Returns whether it passed.
  const attempt = async ({ name, run }) => {
    let passed = false;
    const context = await browser.newContext({ viewport: { width: 1280, height: 720 }, colorScheme: "dark" });
    const fresh = context.newPage.bind(context);
    context.newPage = async () => patient(await fresh());
    const page = await context.newPage();
    const errors = [];
    page.on("pageerror", (e) => errors.push(e.message));
    const said = [];
    page.on("console", (m) => said.push(m.text()));
    page.on("requestfailed", (r) => said.push(`${r.url()}: ${r.failure()?.errorText}`));
    const shot = async (file) => {
      if (!shots) return;
      mkdirSync(shots, { recursive: true });
      await page.screenshot({ path: join(shots, `${file}.png`) });
    };
    const cleanups = [];
    const cleanUp = (fun) => cleanups.push(fun);
    try {
      await run({ page, context, browser, shot, cleanUp });
      if (errors.length) throw new Error(`the page raised: ${errors.join("; ")}`);
      passed = true;
    } catch (error) {
      const seen = [`at ${page.url()}`, ...errors.map((e) => `raised: ${e}`), ...said.slice(-8)];
      console.log(["FAILED: " + name, ...error.message.split("\n").slice(0, 6), ...seen].join("\n    "));
      if (shots)
        await page.screenshot({ path: join(shots, `failed-${name.replace(/\W+/g, "-")}.png`) }).catch(() => {});
    }
    await context.close();
    for (const fun of cleanups) await fun();
    return passed;
  };
  const runs = wanted.flatMap((t) => Array(times).fill(t));
  let failed = [];
  const took = [];
  for (const run of runs) {
    const began = performance.now();
    if (!(await attempt(run))) failed.push(run);
    took.push([(performance.now() - began) / 1000, run.name]);
  }
  took.sort(([a], [b]) => b - a);
  for (const [seconds, name] of took.slice(0, 10)) console.log(`slow: ${seconds.toFixed(1)} s ${name}`);
  // As in bin/test, up to three failed tests run again, and those that pass then are reported as unsteady.
  if (times === 1 && failed.length <= 3) {
    const again = failed;
    failed = [];
    for (const run of again) {
      if (await attempt(run)) console.log(`unsteady: ${run.name} failed, but passed when it ran again`);
      else failed.push(run);
    }
  }
  await browser.close();
  console.log(`${runs.length - failed.length} passed, ${failed.length} failed`);
  return failed.length === 0 && runs.length > 0;
}

// Lets the pages of a context, or one page, open as if the hints of the first visit had been seen.
export const hideHints = (target) =>
  target.addInitScript(() => {
    if (location.protocol.startsWith("http")) localStorage.setItem("situ:hints-seen", "test");
  });
