// Compressed video: the page decodes it, and shows exactly the message at the cursor.
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, dispatch, act, panelOf } from "./studio_page.mjs";

const { video } = JSON.parse(process.argv[2]);
const S = 1e9;
const RATE = 25,
  BARS = 12;

// Returns what the panel shows: the time of the image, its number as drawn in the image, and the note in the corner.
const shown = (page, id) =>
  page.evaluate(
    ([i, bars]) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const { k, x, y, width, height } = view.fit();
      // A turned film has its bars at the left, from the bottom up.
      const turned = width < height;
      const ctx = view.canvas.getContext("2d");
      let number = 0;
      for (let bar = 0; bar < bars; bar++) {
        const along = (bar + 0.5) / bars;
        const [px, py] = turned ? [24, height * (1 - along)] : [width * along, 24];
        const scale = devicePixelRatio;
        const [r] = ctx.getImageData(Math.round((x + k * px) * scale), Math.round((y + k * py) * scale), 1, 1).data;
        if (r > 127) number |= 1 << bar;
      }
      return { at: Number(view.canvas.dataset.at), number, note: view.info.textContent };
    },
    [id, BARS],
  );

// Waits until the page decodes the stream, or has said why it does not. Returns the reason.
const decided = async (page, id) => {
  const state = (i) => {
    const { video: film } = [...window.situStudio.views].find((v) => v.el.id === i).layers[0];
    return film?.source ? { reason: "" } : film?.reason ? { reason: film.reason } : null;
  };
  return (await (await until(page, state, "it is known who decodes the film", id)).jsonValue()).reason;
};

// Returns the time of the message at a time, from the server.
const messageTime = (page, t) =>
  page.evaluate(async (at) => {
    const { client, options } = window.situStudio;
    const q = new URLSearchParams({ stream: "Video", at: client.toAbsolute(at + 1), dir: "previous" });
    const { time } = await (await fetch(`${options.stepUrl()}&${q}`)).json();
    return time === null ? null : client.toRelative(BigInt(time));
  }, t);

// Compares the number in the shown image with the message at random times. `first` is the number of the first image.
async function compareRandomTimes(page, id, times, first = 0) {
  const length = await page.evaluate(() => window.situStudio.time.get().data[1]);
  let seed = 11;
  for (let i = 0; i < times; i++) {
    seed = (seed * 1103515245 + 12345) % 2147483648;
    const t = Math.floor((seed / 2147483648) * length);
    await dispatch(page, { type: "cursor", t });
    await settled(page);
    const expected = await messageTime(page, t);
    const { at, number } = await shown(page, id);
    equal(at, expected, `time of the image at ${t / S} s`);
    equal(number, Math.round((at / S) * RATE) + first, `number of the image at ${t / S} s`);
  }
}

const FILMS = [
  ["bframes.mp4", "H.264 with B-frames"],
  ["opengop.mkv", "H.264 with open groups, in Matroska"],
  ["uneven.mkv", "H.264 at a variable rate"],
  ["cut.mp4", "a film that begins between two key frames", 33],
  ["turned.mp4", "a turned film"],
  ["vp9.webm", "VP9"],
  ["av1.mp4", "AV1"],
  ["jpeg.mov", "JPEG"],
  ["stored", "a recording whose images are stored as H.264"],
  ["odd", "stored images of an odd size"],
];

for (const [file, what, first] of FILMS)
  test(`14 video: the page decodes ${what}`, async ({ page, shot }) => {
    await open(page, video, file);
    const id = await panelOf(page, "Video");
    equal(await decided(page, id), "", "why the server decodes it");
    await compareRandomTimes(page, id, 8, first);
    if (file === "odd") equal((await shown(page, id)).note, "239 × 159", "size");
    await shot(`video-${file}`);
  });

test("14 video: the server decodes what the browser does not, and the panel says so", async ({ page, shot }) => {
  await open(page, video, "hevc.mp4");
  const id = await panelOf(page, "Video");
  ok(/this browser does not decode hvc1/.test(await decided(page, id)), "the reason names the codec");
  await compareRandomTimes(page, id, 4);
  ok(/decoded by the server: this browser/.test((await shown(page, id)).note), "the panel says it");
  await shot("video-server");
});

test("14 video: without WebCodecs the server decodes everything", async ({ page }) => {
  await page.addInitScript(() => delete window.VideoDecoder);
  await open(page, video, "bframes.mp4");
  const id = await panelOf(page, "Video");
  equal(await decided(page, id), "this browser has no WebCodecs", "reason");
  await compareRandomTimes(page, id, 3);
});

test("14 video: a server that refuses packets decodes the film itself", async ({ page }) => {
  await page.route("**/data/packets?**", (route) => {
    const first = Number(new URL(route.request().url()).searchParams.get("first"));
    return first === 0 ? route.continue() : route.fulfill({ status: 422, body: "422 the checksums differ\n" });
  });
  // The first part of this film is not the whole film.
  await open(page, video, "jpeg.mov");
  const id = await panelOf(page, "Video");
  await decided(page, id);
  await dispatch(page, { type: "cursor", t: 3.9 * S });
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).textContent.includes("the checksums differ"),
    "the panel says why",
    id,
  );
  await compareRandomTimes(page, id, 2);
});

test("14 video: the page waits for a server that is away", async ({ page }) => {
  await page.route("**/data/packets?**", (route) => route.abort());
  await open(page, video, "bframes.mp4");
  const id = await panelOf(page, "Video");
  equal(await decided(page, id), "", "why the server decodes it");
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).textContent.includes("the server does not respond"),
    "the panel says it",
    id,
  );
  await page.unroute("**/data/packets?**");
  await until(
    page,
    (i) => document.querySelector(`#${i} .cell-info`).textContent === "240 × 160",
    "the page continues",
    id,
  );
  await compareRandomTimes(page, id, 2);
});

test("14 video: playback shows the images in order, and memory is bounded", async ({ page }) => {
  await open(page, video, "bframes.mp4");
  const id = await panelOf(page, "Video");
  await decided(page, id);
  await act(page, "play");
  const seen = [];
  for (let i = 0; i < 12; i++) {
    const { at, number } = await shown(page, id);
    equal(number, Math.round((at / S) * RATE), "number of an image during playback");
    seen.push(at);
    await page.waitForTimeout(60);
  }
  ok(
    seen.every((t, i) => i === 0 || t >= seen[i - 1]),
    `the images are in order: ${seen}`,
  );
  const cache = await page.evaluate((i) => {
    const { source } = [...window.situStudio.views].find((v) => v.el.id === i).layers[0].video;
    return [source.cache.bytes, source.cache.limit];
  }, id);
  ok(cache[0] <= cache[1], `${cache} bytes of images`);
});
