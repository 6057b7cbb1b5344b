import { test } from "node:test";
import assert from "node:assert/strict";
import { among } from "../../js/page/recent.js";

test("only what is still there is offered; sessions belong to their dataset", () => {
  const all = [
    { path: "/s/talk.0000" },
    { path: "/s/study.json/p01" },
    { path: "/s/gone" },
    { path: "/d/study.json" },
  ];
  assert.deepEqual(
    among(all, ["/d/study.json", "/s/talk.0000"]).map((r) => r.path),
    ["/s/talk.0000", "/s/study.json/p01", "/d/study.json"],
  );
});
