import { test } from "node:test";
import assert from "node:assert/strict";
import { keepExisting } from "../../js/page/recent.js";

test("only existing pages are offered, and sessions belong to their dataset", () => {
  const all = [
    { path: "/s/talk.0000" },
    { path: "/s/study.json/p01" },
    { path: "/s/gone" },
    { path: "/d/study.json" },
  ];
  assert.deepEqual(
    keepExisting(all, ["/d/study.json", "/s/talk.0000"]).map((r) => r.path),
    ["/s/talk.0000", "/s/study.json/p01", "/d/study.json"],
  );
});
