// Replays diffs through the stock client's own Rendered class. In: lines {first, diff, html}. Out: {states, wrong:
// [...]}.
import fs from "node:fs";
import Rendered from "../node_modules/phoenix_live_view/assets/js/phoenix_live_view/rendered.js";

// Attributes that the client adds to the tag of an island, which are not in the server's HTML.
const own = / data-phx-(component|view|id|skip)(="[^"]*")?/g;
const copyRendered = (r) =>
  new Rendered(
    "phx-1",
    JSON.parse(JSON.stringify(r.get(), (k, v) => (k === "newRender" || k === "magicId" ? undefined : v))),
  );

let rendered;
let states = 0;
const wrong = [];
for (const line of fs.readFileSync(process.argv[2], "utf8").trim().split("\n")) {
  const { first, diff, html } = JSON.parse(line);
  let got;
  try {
    if (first) rendered = new Rendered("phx-1", diff);
    else rendered.mergeDiff(diff);
    rendered.toString();
    got = copyRendered(rendered).toString().buffer;
    got = (got.toString?.() ?? got).replace(own, "");
  } catch (error) {
    got = String(error);
  }
  states++;
  if (got !== html && wrong.length < 3) wrong.push({ state: states, html, got, diff });
}
console.log(JSON.stringify({ states, wrong }));
