// Segmentation masks on images: objects in their boxes, and a class for each position.
import { test, equal, ok, until } from "./harness.mjs";
import { open, panelOf, settled } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);

// Returns the color at a position of the image, independent of the panel's size.
const colorAt = (page, id, x, y) =>
  page.evaluate(
    ([i, px, py]) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const map = view.map();
      const k = devicePixelRatio;
      const ctx = view.canvas.getContext("2d");
      return Array.from(ctx.getImageData(Math.round(map.x(px) * k), Math.round(map.y(py) * k), 1, 1).data).slice(
        0,
        3,
      );
    },
    [id, x, y],
  );

const show = async (page, stream, viz) => {
  await page.evaluate(([s, v]) => window.situStudio.options.push("add_viz", { stream: s, viz: v }), [stream, viz]);
  await until(
    page,
    (s) => [...window.situStudio.views].some((v) => v.layers?.some((l) => l.vis.stream === s && l.masks)),
    `the masks of ${stream}`,
    stream,
  );
  await settled(page);
};

test("masks: objects are transparent in their boxes, with class, score and id", async ({ page, shot }) => {
  await open(page, main, "masked");
  await show(page, "Find.Masks", "masks");
  const id = await panelOf(page, "Find.Masks");
  equal(id, await panelOf(page, "Camera.Image"), "it is on top of the image");
  const [bare, left, right] = [
    await colorAt(page, id, 5, 100),
    await colorAt(page, id, 28, 60),
    await colorAt(page, id, 54, 60),
  ];
  ok(Math.abs(bare[0] - 20) < 8 && Math.abs(right[0] - 20) < 8, `nothing next to the mask: ${bare} ${right}`);
  ok(Math.max(...left) > 60 && Math.max(...left) < 200, `the left half of the cup's box is covered: ${left}`);
  const box = await page.evaluate((i) => {
    const view = [...window.situStudio.views].find((v) => v.el.id === i);
    const at = view.canvas.getBoundingClientRect();
    return [at.left + view.map().x(28), at.top + view.map().y(60)];
  }, id);
  await page.mouse.move(...box);
  await until(
    page,
    () =>
      /cup/.test(document.querySelector("#tip")?.textContent ?? document.querySelector(".tip")?.textContent ?? ""),
    "the object under the mouse is named",
  );
  await shot("masks");
});

test("masks: class numbers cover the square that the network received", async ({ page, shot }) => {
  await open(page, main, "masked");
  await show(page, "Classes", "masks");
  const id = await panelOf(page, "Camera.Image");
  const [upper, lower] = [await colorAt(page, id, 80, 30), await colorAt(page, id, 80, 90)];
  ok(Math.max(...upper) > 60, `class 5 covers the upper half: ${upper}`);
  ok(Math.max(...lower) < 40, `the lower half is not covered: ${lower}`);
  await shot("masks-classes");
});
