// Compares texts under the mouse with the messages, for random streams at random zooms. Each run has different
// streams; SEED=N repeats those of a failed run.
import { readFileSync } from "node:fs";
import { test, equal, ok } from "./harness.mjs";
import { open, settled, state, dispatch, legendOf, panelOf, pointAt } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
// The tools of a panel cover the right end of its first lane under the mouse, so positions are left of them.
const ZOOMS = 6,
  PLACES = 3;
// The maximum distance of the mouse from a segment, plus the same for the pixel that it is in.
const NEAR_PX = 5;
const MS = 1e6,
  S = 1e9;

// A pseudorandom number generator with a seed.
function random(seed) {
  let s = (seed * 7919 + 17) % 2147483647;
  return () => (s = (s * 48271) % 2147483647) / 2147483647;
}

// Returns the number of rows at or before a time.
function upTo(rows, t) {
  let lo = 0,
    hi = rows.length;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (rows[mid][0] <= t) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}

// Returns the rows that apply at some time of an interval: the row before it, and the rows in it.
const holding = (rows, a, b) => rows.slice(Math.max(upTo(rows, a) - 1, 0), upTo(rows, b));

function median(rows) {
  const pauses = rows.slice(1).map(([t], i) => t - rows[i][0]);
  return pauses.sort((a, b) => a - b)[pauses.length >> 1] ?? 0;
}

// Converts "1:02.345" to ns.
function time(text) {
  const parts = text.replace("-", "").split(":").map(Number);
  return (text.startsWith("-") ? -1 : 1) * parts.reduce((a, p) => a * 60 + p, 0) * S;
}

function checkLine({ name, rows, period }, { text, exact }, cursor, slack) {
  const t = Math.round(cursor);
  const n = upTo(rows, t);
  const said = `${name} at ${t} says ${JSON.stringify(text)} (${exact})`;
  if (!n) return equal(text, "", `${said} before its first message`);
  equal(Number(exact), rows[n - 1][1], said);
  const value = Number(text.split(",")[0]);
  ok(
    Math.abs(value - rows[n - 1][1]) <= 1e-5 * Math.max(Math.abs(value), 1),
    `${said}, the message ${rows[n - 1][1]}`,
  );
  const age = t - rows[n - 1][0];
  if (age > S + slack) ok(text.includes(" ago"), `${said}, which is ${age / MS} ms old`);
  if (period && age < Math.min(period, S) && slack < period) ok(!text.includes(" ago"), `${said} while it is new`);
}

// Returns the tooltip of a lane as {label, from, to}, or null if there is none.
async function tip(page) {
  const text = await page.evaluate(() => {
    const el = document.getElementById("tip");
    return el && !el.hidden ? el.textContent : "";
  });
  if (!text) return null;
  const [label, when] = text.split("\n");
  const since = /^since (\S+)/.exec(when);
  const [, from, to] = since ? [null, since[1], null] : /^(\S+) to (\S+),/.exec(when);
  return { label, from: time(from), to: to ? time(to) : Infinity };
}

function checkLane({ name, period }, rows, found, t, slack) {
  const at = `${name} at ${t}`;
  const n = upTo(rows, t);
  const [row, later] = [rows[n - 1], rows[n]];
  if (!found) {
    const pause = (later?.[0] ?? Infinity) - (row?.[0] ?? -Infinity);
    return ok(!row || !later || pause > median(rows), `${at} nothing is shown between ${row} and ${later}`);
  }
  const { label, from, to } = found;
  const inside = rows.slice(upTo(rows, from + slack), upTo(rows, to - slack));
  if (/\d/.test(label)) {
    const all = holding(rows, from - slack, Math.min(to, 1e18) + slack);
    return ok(new Set(all.map(([, v]) => v)).size > 1, `${at} says ${label} of messages that all say the same`);
  }
  const other = inside.find(([, v]) => String(v) !== label);
  ok(!other, `${at} says ${label} from ${from} to ${to}, but the message at ${other?.[0]} says ${other?.[1]}`);
  ok(
    holding(rows, t - slack, t + slack).some(([, v]) => String(v) === label),
    `${at} says ${label}, the message says ${row?.[1]}`,
  );
  // A state is not drawn across a gap of a regular stream.
  const pause = (later?.[0] ?? 0) - (row?.[0] ?? 0);
  const hole = period && row && later && pause > 30 * period + 4 * slack;
  if (hole) ok(t < row[0] + pause / 4 || t > later[0] - slack, `${at} says ${label} in a gap of ${pause} ns`);
}

// Moves the mouse to a lane's row.
async function pointLane(page, id, stream, key, t) {
  const at = await pointAt(page, id, t);
  const y = await page.evaluate(
    ([i, s, k]) => {
      const v = [...window.situStudio.views].find((w) => w.el.id === i);
      const n = v.rows.findIndex((r) => r.l.vis.stream === s && r.lane === k);
      return n < 0 ? null : v.el.getBoundingClientRect().top + 4 + (n + 0.5) * v.row;
    },
    [id, stream, key],
  );
  ok(y !== null, `${stream} ${key} has a lane`);
  await page.mouse.move(at.x, y);
}

test("7 random: the text under the mouse agrees with the messages for random streams and zooms", async ({ page }) => {
  const { seed, recordings } = JSON.parse(readFileSync(site.random, "utf8"));
  await page.setViewportSize({ width: 1280, height: 1000 });
  let compared = 0;
  try {
    for (const [i, { name, length, streams }] of recordings.entries()) {
      const next = random(seed + i);
      await open(page, site.main, name);
      for (let k = 0; k < ZOOMS; k++) {
        const width = k ? length * 2e-4 ** next() : length;
        const from = next() * (length - width);
        await dispatch(page, { type: "view", from, to: from + width });
        await settled(page);
        for (let p = 0; p < PLACES; p++) compared += await look(page, streams, 0.02 + 0.76 * next());
      }
    }
  } catch (error) {
    throw new Error(`SEED=${seed}: ${error.message}`);
  }
  ok(compared > recordings.length * ZOOMS * PLACES * 4, `${compared} values were compared`);
});

async function look(page, streams, part) {
  const { view } = await state(page);
  const wanted = view[0] + part * (view[1] - view[0]);
  let n = 0;
  for (const stream of streams) {
    const id = await panelOf(page, stream.name);
    await page.$eval(`#${id}`, (e) => e.scrollIntoView({ block: "nearest" }));
    const px = (view[1] - view[0]) / (await page.$eval(`#${id}`, (e) => e.clientWidth - 220));
    const slack = NEAR_PX * px + 1.1 * MS;
    if (stream.kind === "number") {
      await pointAt(page, id, wanted);
      const t = (await state(page)).cursor;
      ok(Math.abs(t - wanted) < slack, `the cursor is at the mouse: ${t}, ${wanted}`);
      checkLine(stream, await legendOf(page, stream.name), t, slack);
      n++;
      continue;
    }
    for (const key of stream.kind === "map" ? ["a", "b"] : [""]) {
      await pointLane(page, id, stream.name, key, wanted);
      const t = (await state(page)).cursor;
      const rows = key ? stream.rows.map(([at, m]) => [at, m[key]]) : stream.rows;
      checkLane(stream, rows, await tip(page), t, slack);
      n++;
    }
  }
  equal((await state(page)).view, view, "the mouse does not move the view");
  return n;
}
