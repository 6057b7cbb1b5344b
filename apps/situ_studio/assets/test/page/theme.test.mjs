import { test } from "node:test";
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { contrastRatio } from "../../js/page/theme.js";

const css = readFileSync(new URL("../../css/theme.css", import.meta.url), "utf8");

function readColors(selector) {
  const block = css.slice(css.indexOf(selector), css.indexOf("}", css.indexOf(selector)));
  return Object.fromEntries([...block.matchAll(/--([\w-]+): (#[0-9a-f]{6});/g)].map((m) => [m[1], m[2]]));
}

test("the contrast ratio follows the W3C", () => {
  assert.equal(contrastRatio("#000000", "#ffffff"), 21);
  assert.equal(contrastRatio("#777777", "#ffffff").toFixed(2), "4.48");
});

for (const [name, selector] of [
  ["dark", ":root {"],
  ["light", ':root[data-theme="light"] {'],
]) {
  const c = readColors(selector);

  test(`${name}: text is readable`, () => {
    for (const text of ["text", "axis", "dim", "accent", "cursor", "warn", "sel-start", "sel-end"]) {
      for (const ground of ["bg", "panel", "raised"]) {
        const k = contrastRatio(c[text], c[ground]);
        assert.ok(k >= 4.5, `${text} on ${ground}: ${k.toFixed(2)}`);
      }
    }
    assert.ok(contrastRatio(c["on-accent"], c.accent) >= 4.5);
  });

  test(`${name}: lines are distinguishable from the background, and their labels are readable`, () => {
    for (let i = 0; i < 8; i++) {
      assert.ok(contrastRatio(c[`s${i}`], c.panel) >= 3, `s${i}: ${contrastRatio(c[`s${i}`], c.panel).toFixed(2)}`);
      const best = Math.max(contrastRatio(c.bg, c[`s${i}`]), contrastRatio(c.text, c[`s${i}`]));
      assert.ok(best >= 4.1, `label on s${i}: ${best.toFixed(2)}`);
    }
  });
}
