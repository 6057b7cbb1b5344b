// The page that acts as a camera and microphone, with Chromium's simulated devices: a green image, and beeps.
import { readFileSync } from "node:fs";
import { test, ok, near, until } from "./harness.mjs";

const site = JSON.parse(process.argv[2]);

const stats = () => JSON.parse(readFileSync(site.sensor, "utf8"));

async function statsUntil(good, what) {
  let seen;
  for (let i = 0; i < 600; i++) {
    try {
      if (good((seen = stats()))) return seen;
    } catch {
      // The file is not written yet.
    }
    await new Promise((done) => setTimeout(done, 50));
  }
  throw new Error(`timed out waiting until ${what}: ${JSON.stringify(seen)}`);
}

test("sensor: camera and microphone of a page reach the pipeline, and its audio reaches the page", async ({
  page,
  context,
}) => {
  await context.grantPermissions(["camera", "microphone"], { origin: site.main });
  await page.goto(site.main + "/sensor?name=browser");
  await page.click("#start");
  await until(page, () => window.situSensor.sent > 5 && window.situSensor.heard > 48000, "it sends");
  const got = await statsUntil((s) => s.pictures > 5 && s.seconds > 1, "the pipeline has it");
  ok(got.width === 640 && got.height === 480, `the image's size: ${got.width} x ${got.height}`);
  // Chromium's simulated camera is green, with a moving clock, and its microphone beeps.
  ok(got.green > got.red && got.green > got.blue, `it is green: ${JSON.stringify(got)}`);
  ok(got.loudest > 1000, `it beeps: ${got.loudest}`);
  near(got.late_ms, 0, 20000, "the images' time is about now");
  // Page and server share a clock here, so the measured offset is the error.
  near(await page.evaluate(() => window.situSensor.offset), 0, 2000, "the difference of the clocks");
  await until(page, () => window.situSensor.played > 8000, "the pipeline's audio is played");
  const cameras = await page.evaluate(() => document.querySelectorAll("#camera option").length);
  ok(cameras >= 2, "cameras to choose from, and none");
  await page.click("#stop");
  await until(page, () => document.getElementById("status").textContent === "Stopped.", "it stops");
});

test("sensor: while a pipeline does not accept images, the page drops them", async ({ page, context }) => {
  await context.grantPermissions(["camera", "microphone"], { origin: site.main });
  await page.goto(site.main + "/sensor?name=stuck");
  await page.click("#start");
  await until(page, () => window.situSensor.dropped > 20, "images are dropped");
  ok((await page.evaluate(() => window.situSensor.sent)) < 12, "only a few images are sent");
});

test("sensor: a missing pipeline is reported", async ({ page, context }) => {
  await context.grantPermissions(["camera", "microphone"], { origin: site.main });
  await page.goto(site.main + "/sensor?name=nobody");
  await page.click("#start");
  await until(
    page,
    () => document.getElementById("status").textContent.includes("no pipeline has a sensor"),
    "it is reported",
  );
  for (const id of ["camera", "microphone"]) await page.selectOption("#" + id, "none");
  await page.click("#start");
  await until(
    page,
    () => document.getElementById("status").textContent.startsWith("No camera or microphone selected"),
    "without devices, it shows instructions",
  );
});
