// Computes the spectra of short audio segments. Pure: used by the worker and by tests.

// The lowest level that is shown, in dB relative to full scale.
export const FLOOR = -100;

// Returns the levels of the frequencies of `count` segments of `n` samples (a power of two): n / 2 bytes each, 0 for
// FLOOR dB and below, 255 for a full sine.
export function computeLevels(samples, count, n) {
  const out = new Uint8Array((count * n) / 2);
  const { window, sum } = hannWindow(n);
  const re = new Float64Array(n),
    im = new Float64Array(n);
  for (let k = 0; k < count; k++) {
    for (let i = 0; i < n; i++) {
      re[i] = samples[k * n + i] * window[i];
      im[i] = 0;
    }
    fft(re, im);
    for (let i = 0; i < n / 2; i++) {
      const power = (re[i] * re[i] + im[i] * im[i]) * (2 / sum) ** 2;
      const db = 10 * Math.log10(Math.max(power, 1e-20));
      out[(k * n) / 2 + i] = Math.round(Math.min(Math.max(1 - db / FLOOR, 0), 1) * 255);
    }
  }
  return out;
}

function hannWindow(n) {
  const window = Float64Array.from({ length: n }, (_, i) => 0.5 - 0.5 * Math.cos((2 * Math.PI * i) / n));
  return { window, sum: window.reduce((a, b) => a + b, 0) };
}

// Transforms in place by decimation in time.
export function fft(re, im) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) {
      [re[i], re[j]] = [re[j], re[i]];
      [im[i], im[j]] = [im[j], im[i]];
    }
  }
  for (let size = 2; size <= n; size *= 2) {
    const angle = (-2 * Math.PI) / size;
    for (let k = 0; k < size / 2; k++) {
      const c = Math.cos(angle * k),
        s = Math.sin(angle * k);
      for (let i = k; i < n; i += size) {
        const j = i + size / 2;
        const x = re[j] * c - im[j] * s,
          y = re[j] * s + im[j] * c;
        re[j] = re[i] - x;
        im[j] = im[i] - y;
        re[i] += x;
        im[i] += y;
      }
    }
  }
}
