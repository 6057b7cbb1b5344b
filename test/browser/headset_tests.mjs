// The headset page in Chromium with an emulated headset (iwer): poses reach a pipeline, and its drawings are
// displayed.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { test, ok, equal, near, until } from "./harness.mjs";

const site = JSON.parse(process.argv[2]);
const require = createRequire(import.meta.url);
const emulator = readFileSync(require.resolve("iwer").replace(/lib.index\.js$/, "build/iwer.min.js"), "utf8");

async function seenUntil(good, what) {
  let seen;
  for (let i = 0; i < 600; i++) {
    try {
      if (good((seen = JSON.parse(readFileSync(site.headset, "utf8"))))) return seen;
    } catch {
      // The file is not written yet.
    }
    await new Promise((done) => setTimeout(done, 50));
  }
  throw new Error(`timed out waiting until ${what}: ${JSON.stringify(seen)}`);
}

const all = (a, b, by = 1e-3) => a?.length === b.length && a.every((v, i) => Math.abs(v - b[i]) <= by);

// Emulates a headset whose wearer is at the origin, 1.6 m tall, and shows both hands. One plane is the floor.
async function wear(page) {
  await page.addInitScript(emulator);
  await page.addInitScript(() => {
    const { XRDevice, metaQuestPro, NativePlane, XRRigidTransform } = window.IWER;
    const device = new XRDevice(metaQuestPro, { stereoEnabled: false });
    device.installRuntime({ forceInstall: true });
    device.primaryInputMode = "hand";
    device.position.set(0, 1.6, 0);
    device.gaze.connected = true;
    const corners = [-1, 1, 1, -1].map((x, i) => new DOMPointReadOnly(x, 0, i < 2 ? -2 : 2));
    const floor = new NativePlane(new XRRigidTransform({ x: 0, y: 0, z: -3 }), corners, "floor");
    // The emulator asks for an image and the planes of its surroundings.
    const picture = document.createElement("canvas");
    picture.style.display = "none";
    const surroundings = {
      environmentCanvas: picture,
      trackedPlanes: new Set([floor]),
      trackedMeshes: new Set(),
      render() {},
    };
    device.installSEM(function () {
      return surroundings;
    });
    window.device = device;
  });
}

// Counts the red and green pixels in the left and the right half of the view.
async function countPixels(page) {
  const png = (await page.screenshot()).toString("base64");
  return page.evaluate(async (base64) => {
    const image = await createImageBitmap(new Blob([Uint8Array.from(atob(base64), (c) => c.charCodeAt(0))]));
    const canvas = new OffscreenCanvas(image.width, image.height);
    const ctx = canvas.getContext("2d");
    ctx.drawImage(image, 0, 0);
    const { data } = ctx.getImageData(0, 0, image.width, image.height);
    const count = { red: [0, 0], green: [0, 0] };
    for (let i = 0; i < data.length; i += 4) {
      const half = (i / 4) % image.width < image.width / 2 ? 0 : 1;
      if (data[i] > 150 && data[i + 1] < 30 && data[i + 2] < 30) count.red[half]++;
      if (data[i + 1] > 150 && data[i] < 90 && data[i + 2] < 90) count.green[half]++;
    }
    return count;
  }, png);
}

async function seeUntil(page, good, what) {
  let last;
  for (const end = Date.now() + 30000; Date.now() < end;) if (good((last = await countPixels(page)))) return;
  throw new Error(`timed out waiting until ${what}: ${JSON.stringify(last)}`);
}

test("headset: head, hands, gaze and planes reach the pipeline, and its drawings are visible", async ({
  page,
  shot,
}) => {
  await wear(page);
  await page.goto(site.main + "/headset?name=emulated");
  await until(page, () => !document.getElementById("start").disabled, "the headset is available");
  await page.click("#start");
  await until(page, () => window.situHeadset.sent > 5 && window.situHeadset.drawn > 1, "it sends and draws");
  const first = await seenUntil((s) => all(s.head, [0, 0, 1.6]) && s.left && s.right, "the pipeline has it");
  near(first.yaw, 0, 1e-3, "the gaze is ahead");
  near(first.late_ms, 0, 20000, "the times are about now");
  equal([first.left.joints, first.right.joints], [26, 26], "joints");
  // The hands are in front of the wearer, the left one on the left.
  ok(first.left.wrist[1] > first.right.wrist[1], `left is left: ${JSON.stringify(first)}`);
  ok(first.left.tip[0] > first.left.wrist[0], "the fingers point away");
  const floor = await seenUntil((s) => s.planes?.length === 1 && s.gaze, "a plane and the gaze");
  equal(floor.planes[0].label, "floor", "its semantic label");
  near(floor.planes[0].width, 2, 1e-3, "its width");
  ok(all(floor.planes[0].at, [3, 0, 0]), `its position: ${floor.planes[0].at}`);
  ok(all(floor.gaze, [1, 0, 0], 0.05), `the gaze is ahead: ${floor.gaze}`);
  // The box is ahead on the left, the sign at the right hand.
  await seeUntil(page, ({ red, green }) => red[0] > 50 && red[1] === 0 && green[1] > 200, "both are seen");
  await shot("headset");

  // Pinches, steps forward, and looks to the left.
  await page.evaluate(() => window.device.hands.right.updatePinchValue(1));
  await seenUntil((s) => s.select?.right === true, "the pinch is reported");
  await page.evaluate(() => {
    window.device.position.set(-0.5, 1.6, -1);
    window.device.quaternion.set(0, Math.SQRT1_2, 0, Math.SQRT1_2);
  });
  const turned = await seenUntil((s) => all(s.head, [1, 0.5, 1.6]), "it stepped");
  near(turned.yaw, Math.PI / 2, 1e-3, "it looks left");
  await seeUntil(page, ({ red }) => red[0] + red[1] === 0, "the box is out of sight");
  // The headset's view covers the page.
  await page.evaluate(() => document.getElementById("stop").click());
  await until(page, () => document.getElementById("status").textContent === "Stopped.", "it stops");
});

test("headset: errors are shown for a browser without WebXR and for a missing pipeline", async ({
  page,
  context,
}) => {
  await page.goto(site.main + "/headset?name=emulated");
  const told = (text) => document.getElementById("status").textContent.includes(text);
  await until(page, told, "it says so", "does not support headsets");
  const other = await context.newPage();
  await wear(other);
  await other.goto(site.main + "/headset?name=nobody");
  await until(other, () => !document.getElementById("start").disabled, "the headset is available");
  await other.click("#start");
  await until(other, told, "it says so", "no pipeline has a sensor");
});
