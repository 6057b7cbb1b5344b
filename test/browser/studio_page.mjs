// Actions of the tests on a studio's page.
import { until } from "./harness.mjs";

export async function open(page, base, source, query = "") {
  await page.goto(`${base}/s/${source}${query}`);
  await until(
    page,
    () => document.body?.dataset.ready === "1" && document.body?.dataset.connection === "open",
    "the page has data",
  );
  if ((await state(page)).mode !== "live") await settled(page);
}

let waits = 0;

// Waits until no request is in flight and no drawing is pending, in five animation frames in a row, because a reply
// may cause another request.
export async function settled(page) {
  const still = (wait) => {
    const s = window.situStudio;
    const calm =
      s &&
      !s.client.inflight &&
      s.frames.dirty.size === 0 &&
      ![...s.views].some((v) => v.layers?.some((l) => l.decoding));
    if (window.stillness?.wait !== wait) window.stillness = { wait, frames: 0 };
    window.stillness.frames = calm ? window.stillness.frames + 1 : 0;
    return window.stillness.frames > 4;
  };
  await until(page, still, "the page is still", ++waits, "raf");
}

export const state = (page) => page.evaluate(() => window.situStudio.time.get());
export const act = (page, name) => page.evaluate((n) => window.situStudio.runAction(n), name);
export const dispatch = (page, action) => page.evaluate((a) => void window.situStudio.time.dispatch(a), action);

// Answers the page's own question with the keyboard.
export async function answer(page, text) {
  await until(page, () => document.activeElement?.closest("#question"), "a question has the focus");
  if (text !== undefined) await page.keyboard.type(text);
  await page.keyboard.press("Enter");
  await until(page, () => !document.querySelector("#question"), "it is answered");
}

// Waits until the header, which is painted with the next frame, has this length.
export const lengthIs = (page, seconds, by) =>
  until(
    page,
    ([s, d]) => Math.abs(parseFloat(document.getElementById("t-length").textContent) - s) <= d,
    `the length in the header is ${seconds} s`,
    [seconds, by],
  );

// Returns the color at a fraction of a panel's canvas.
export function pixel(page, selector, fx, fy) {
  return page.evaluate(
    ([sel, x, y]) => {
      const c = document.querySelector(sel);
      const d = c.getContext("2d").getImageData(Math.floor(c.width * x), Math.floor(c.height * y), 1, 1).data;
      return Array.from(d);
    },
    [selector, fx, fy],
  );
}

// Counts the pixels of a canvas that have approximately this color.
export function count(page, selector, rgb, tolerance = 40) {
  return page.evaluate(
    ([sel, [r, g, b], t]) => {
      const c = document.querySelector(sel);
      const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
      let n = 0;
      for (let i = 0; i < d.length; i += 4) {
        if (d[i + 3] > 120 && Math.abs(d[i] - r) < t && Math.abs(d[i + 1] - g) < t && Math.abs(d[i + 2] - b) < t) n++;
      }
      return n;
    },
    [selector, rgb, tolerance],
  );
}

// Waits for a panel that shows a stream, and returns its id.
export async function panelOf(page, stream) {
  const find = (s) => {
    for (const el of document.querySelectorAll("[phx-hook='Panel']")) {
      const config = JSON.parse(el.dataset.config);
      if (config.vis.some((v) => v.stream === s)) return el.id;
    }
    return null;
  };
  await until(page, find, `a panel shows ${stream}`, stream);
  return page.evaluate(find, stream);
}

// Waits for the server's reply, and returns the legend's value of a stream at the cursor: {text, exact}, where
// `exact` is the unrounded value.
export async function legendOf(page, stream) {
  const find = (s) => {
    const at = document.querySelector(`.legend-item[data-stream="${CSS.escape(s)}"] b`);
    const { client, time } = window.situStudio;
    if (!at || at.matches(".waiting") || !client.origin || time.get().mode === "play") return null;
    const exact = /^at the cursor: (.*)$/m.exec(at.title)?.[1] ?? "";
    return { text: at.textContent, exact };
  };
  return (await until(page, find, `the value of ${stream} is shown`, stream)).jsonValue();
}

// Moves the mouse to `t` (ns after the start) on a timeline.
export async function pointAt(page, id, t) {
  const { x, y } = await page.evaluate(
    ([i, time]) => {
      const box = document.getElementById(i).getBoundingClientRect();
      const [a, b] = window.situStudio.time.get().view;
      return {
        x:
          box.left +
          window.situStudio.gutter.left +
          ((time - a) / (b - a)) * (box.width - window.situStudio.gutter.left - 14),
        y: box.top + box.height / 2,
      };
    },
    [id, t],
  );
  await page.mouse.move(x, y);
  return { x, y };
}

// Returns the color of a stream on the page as [r, g, b], or that of the nth key of a map.
export const colorOf = (page, stream, nth = 0) =>
  page.evaluate(
    ([name, k]) => {
      const panels = [...document.querySelectorAll("[phx-hook='Panel']")].map((e) => JSON.parse(e.dataset.config));
      const vis = panels.flatMap((p) => p.vis).find((v) => v.stream === name);
      const own =
        vis.props.color ??
        getComputedStyle(document.documentElement)
          .getPropertyValue(`--s${(vis.color + k) % 8}`)
          .trim();
      return [1, 3, 5].map((i) => parseInt(own.slice(i, i + 2), 16));
    },
    [stream, nth],
  );

// Returns the panel of a view's element: "p1" for "body-p1-plot".
export const panelIn = (id) => /^body-(\w+)-/.exec(id)[1];

// Creates annotations with the values "speaks" and "laughs" in the dialog, with the keyboard alone.
export async function typeNewAnnotations(page, name) {
  await page.keyboard.press("a");
  await until(page, () => document.activeElement?.closest("#annotation-new"), "the dialog has the focus");
  await page.keyboard.type(name);
  await page.keyboard.press("Tab");
  await page.keyboard.type("speaks 1 #ff00ff");
  await page.keyboard.press("Enter");
  await page.keyboard.type("laughs 2");
  // Skips the fields for the kind and the annotator.
  await page.keyboard.press("Tab");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
}
