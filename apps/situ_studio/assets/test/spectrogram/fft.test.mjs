import { test } from "node:test";
import assert from "node:assert/strict";
import { fft, computeLevels } from "../../js/spectrogram/fft.js";

// The transform by its definition.
function directTransform(x) {
  const n = x.length;
  return x.map((_, k) => {
    let re = 0,
      im = 0;
    for (let i = 0; i < n; i++) {
      re += x[i] * Math.cos((2 * Math.PI * k * i) / n);
      im -= x[i] * Math.sin((2 * Math.PI * k * i) / n);
    }
    return [re, im];
  });
}

test("the FFT matches the definition", () => {
  for (const n of [2, 8, 64, 256]) {
    let seed = n;
    const x = Array.from({ length: n }, () => (seed = (seed * 48271) % 2147483647) / 2147483647 - 0.5);
    const re = Float64Array.from(x),
      im = new Float64Array(n);
    fft(re, im);
    directTransform(x).forEach(([a, b], k) => {
      assert.ok(Math.abs(re[k] - a) < 1e-9 * n, `real part ${k} of ${n}`);
      assert.ok(Math.abs(im[k] - b) < 1e-9 * n, `imaginary part ${k} of ${n}`);
    });
  }
});

test("a full-scale sine is loudest at its frequency, and silence has no levels", () => {
  const n = 512;
  const sine = Float32Array.from({ length: 2 * n }, (_, i) => (i < n ? Math.sin((2 * Math.PI * 64 * i) / n) : 0));
  const found = computeLevels(sine, 2, n);
  const loudest = found.subarray(0, n / 2).indexOf(Math.max(...found.subarray(0, n / 2)));
  assert.equal(loudest, 64);
  assert.equal(found[64], 255);
  assert.ok(found[80] < 40, "quiet at other frequencies");
  assert.ok(
    found.subarray(n / 2).every((v) => v === 0),
    "silence",
  );
});
