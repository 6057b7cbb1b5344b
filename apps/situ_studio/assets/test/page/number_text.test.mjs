import test from "node:test";
import assert from "node:assert/strict";
import {
  axisNumber,
  valueFraction,
  paddedRange,
  tickCount,
  valueText,
  valueTicks,
} from "../../js/page/number_text.js";

test("axis labels are short for large and small numbers", () => {
  const said = [0, 0.25, 1500, 25e3, 1e18, 1.5e294, 1e-9, -2.5e-7].map((x) => axisNumber(x));
  assert.deepEqual(said, ["0", "0.25", "1500", "25 k", "1e18", "1.5e294", "1e-9", "-2.5e-7"]);
});

test("axis labels are long enough to distinguish all ticks", () => {
  for (const [lo, hi] of [
    [1e6, 1e6 + 6e-6],
    [123456789, 123456789.5],
    [9007199254740992, 9007199254741052],
    [-1e-9, 1e-9],
    [5e15, 5e15 + 40],
    [0.1, 0.1 + 1e-12],
    [-1.7e308, 1.7e308],
    [21_000, 21_003],
  ]) {
    const at = valueTicks(lo, hi, 5);
    const texts = at.map((v) => axisNumber(v, at[1] - at[0]));
    assert.ok(at.length >= 2, `${lo} to ${hi}: ${at}`);
    assert.equal(new Set(texts).size, texts.length, `${lo} to ${hi}: ${texts}`);
    texts.forEach((t, i) => {
      const letter = { k: 1e3, M: 1e6, G: 1e9, T: 1e12 }[t.at(-1)] ?? 1;
      const read = parseFloat(t) * letter;
      assert.ok(Math.abs(read - at[i]) <= (at[1] - at[0]) / 2, `${t} is the tick ${at[i]}`);
    });
  }
});

test("an axis has at least two ticks, and few if it is high", () => {
  assert.deepEqual([20, 60, 150, 800].map(tickCount), [2, 2, 5, 14]);
  assert.ok(valueTicks(-1e293, 1.1e294, 4).length >= 2);
});

test("a value that people wrote is shown in full", () => {
  const exact = ["123456789.123", "1000000.00001", "9007199254740993", "0.25", "-3", "1.0", "1.7e308", "5.0e-9"];
  const shown = ["123456789.123", "1000000.00001", "9007199254740993", "0.25", "-3", "1", "1.7e+308", "5e-9"];
  assert.deepEqual(
    exact.map((e) => valueText(e)),
    shown,
  );
  assert.deepEqual(
    ["true", "nan", ""].map((e) => valueText(e)),
    ["true", "nan", ""],
  );
});

test("a computed value has enough digits to differ from its neighbors", () => {
  assert.equal(valueText("0.8414709848078965"), "0.841471");
  assert.equal(valueText("0.8414709848078965", 1e-9), "0.8414709848");
  for (const [x, apart] of [
    [1000000.0000031234, 1e-6],
    [Math.PI * 1e7, 1e-3],
    [Math.E * 1e-12, 1e-20],
    [-12345.678901234567, 2e-9],
  ]) {
    const [a, b] = [valueText(String(x), apart), valueText(String(x + apart), apart)];
    assert.notEqual(a, b);
    assert.ok(Math.abs(Number(a) - x) < apart / 2, `${a} is ${x}`);
  }
});

test("the largest numbers have a range, ticks and positions", () => {
  const [lo, hi] = paddedRange([[-1.7e308, 1.7e308]]);
  assert.ok(Number.isFinite(lo) && Number.isFinite(hi) && lo < -1.7e308 && hi > 1.7e308);
  assert.equal(valueFraction(0, lo, hi), 0.5);
  assert.equal(valueFraction(lo, lo, hi), 0);
  assert.equal(valueFraction(hi, lo, hi), 1);
  assert.equal(valueFraction(3, 2, 6), 0.25);
});

test("an axis of numbers that differ only in their last digits has its ends as ticks", () => {
  for (const [lo, hi] of [
    [1e12, 1e12 + 0.000244140625],
    [-1e300, -1e300 * (1 - 2e-16)],
    [2 ** 53, 2 ** 53 + 2],
  ]) {
    const ticks = valueTicks(lo, hi, 6);
    assert.ok(ticks.length >= 2 && ticks.length < 60, `${lo} to ${hi}: ${ticks.length} ticks`);
    assert.ok(ticks.every((v) => v >= lo && v <= hi));
    assert.equal(new Set(ticks).size, ticks.length);
  }
});
