// How often messages come, and which pauses are holes. Pure.

const LOOKED_AT = 256;
// A pause of so many periods is a hole in what comes regularly.
const MISSED = 8;
// Messages come regularly when nine of ten pauses are not longer than so many usual ones.
const STEADY = 2.5;

// rows: {t, n, length}, columns of the times (first of its messages) and the messages of each row. Answers {period,
// row}: the usual time between messages and between rows in ns; a period of Infinity where they come as they like.
export function rhythm({ t, n, length }) {
  const pauses = [],
    periods = [];
  const step = Math.max(1, Math.floor((length - 1) / LOOKED_AT));
  for (let i = 0; i + 1 < length; i += step) {
    pauses.push(t[i + 1] - t[i]);
    periods.push((t[i + 1] - t[i]) / Math.max(n[i], 1));
  }
  if (pauses.length < 4) return { period: Infinity, row: median(pauses) };
  periods.sort((a, b) => a - b);
  const usual = periods[periods.length >> 1];
  const steady = periods[Math.floor(periods.length * 0.9)] <= STEADY * usual;
  return { period: steady ? usual : Infinity, row: median(pauses) };
}

// How long a pause may be behind a row of `n` messages before it is a hole. A series that grows live has rows of one
// message behind older ones of many.
export function patience({ period, row }, n) {
  return Math.max(row + MISSED * period, 1.5 * row, (1.5 * n + MISSED) * period);
}

function median(values) {
  if (!values.length) return 0;
  return values.slice().sort((a, b) => a - b)[values.length >> 1];
}
