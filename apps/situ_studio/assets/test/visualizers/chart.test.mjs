import test from "node:test";
import assert from "node:assert/strict";

globalThis.localStorage = { getItem: () => null };
globalThis.document = { documentElement: { dataset: {} } };
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "#808080" });
globalThis.matchMedia = () => ({ matches: false, addEventListener() {} });
globalThis.addEventListener ??= () => {};
const { drawChart } = await import("../../js/visualizers/chart.js");

const series = [
  {
    name: "a",
    color: "#a00000",
    rows: [
      ["x", 1],
      ["y", 3],
    ],
  },
  { name: "b", color: "#00b000", rows: [["y", -1]] },
];

// Returns the drawing calls, with their color.
function recordCalls(props, given = series) {
  const out = [];
  const ctx = new Proxy(
    { measureText: (t) => ({ width: 6 * t.length }) },
    {
      get: (own, name) =>
        own[name] ??
        ((...args) => {
          if (["fillRect", "lineTo", "moveTo"].includes(name))
            out.push([name, own.fillStyle, ...args.map(Math.round)]);
        }),
      set: (own, name, value) => ((own[name] = value), true),
    },
  );
  drawChart(ctx, { series: given, w: 300, h: 200, props });
  return out;
}

const callsOf = (calls, color, name) => calls.filter(([n, c]) => c === color && n === name).map((c) => c.slice(2));

test("bars are side by side from zero, and horizontal if requested", () => {
  const [x, y] = callsOf(recordCalls({}), "#a00000", "fillRect");
  assert.ok(Math.abs(y[3] / x[3] - 3) < 0.1, `three times as high: ${x} ${y}`);
  assert.equal(x[1] + x[3], y[1] + y[3], "both start at zero");
  const below = callsOf(recordCalls({}), "#00b000", "fillRect").find(([, , w]) => w > 9);
  assert.equal(below[1], y[1] + y[3], "negative bars are below zero");
  assert.ok(below[0] >= y[0] + y[2], "next to its neighbor");
  const [p, q] = callsOf(recordCalls({ lying: true }), "#a00000", "fillRect").filter(([, , w]) => w !== 9);
  assert.ok(Math.abs(q[2] / p[2] - 3) < 0.1, `three times as long: ${p} ${q}`);
  assert.equal(p[0], q[0]);
});

test("stacked bars begin where the previous one ends", () => {
  const up = [series[0], { name: "b", color: "#00b000", rows: [["y", 2]] }];
  const calls = recordCalls({ kind: "stacked" }, up);
  const [, y] = callsOf(calls, "#a00000", "fillRect").filter(([, , w]) => w !== 9);
  const [b] = callsOf(calls, "#00b000", "fillRect").filter(([, , w]) => w !== 9);
  assert.equal(b[0], y[0]);
  assert.equal(b[1] + b[3], y[1]);
});

test("numeric names are positions on the x axis", () => {
  const rows = [
    ["0", 0],
    ["10", 1],
    ["1", 2],
  ];
  const places = callsOf(recordCalls({ kind: "xy" }, [{ name: "", color: "#a00000", rows }]), "#a00000", "lineTo");
  const [from] = callsOf(recordCalls({ kind: "xy" }, [{ name: "", color: "#a00000", rows }]), "#a00000", "moveTo");
  assert.ok(Math.abs((places[0][0] - from[0]) * 10 - (places[1][0] - from[0])) < 12, `${from} ${places}`);
});
