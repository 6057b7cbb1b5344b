// Determines how often messages arrive and which pauses are gaps. Pure.

const LOOKED_AT = 256;
// In regular data, a pause of this many periods is a gap.
const MISSED = 8;
// Data are regular if nine of ten pauses are at most this many times the usual one.
const STEADY = 2.5;

// Takes rows {t, n, length}: columns with the time of the first message and the number of messages of each row.
// Returns {period, row}, the usual time between messages and between rows in ns. The period of irregular data is
// Infinity.
export function measureRhythm({ t, n, length }) {
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

// Returns how long the pause after a row of `n` messages may be before it is a gap. In a series that grows live,
// rows of a single message follow older rows of many.
export function gapThreshold({ period, row }, n) {
  return Math.max(row + MISSED * period, 1.5 * row, (1.5 * n + MISSED) * period);
}

function median(values) {
  if (!values.length) return 0;
  return values.slice().sort((a, b) => a - b)[values.length >> 1];
}
