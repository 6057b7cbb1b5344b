import test from "node:test";
import assert from "node:assert/strict";
import { backAddress } from "../../js/page/back_link.js";

test("the back link leads to the previous page of this studio", () => {
  const base = "https://lab.example/studio/",
    here = base + "settings";
  assert.equal(backAddress(base + "s/Talk.0000?at=5", here, base), base + "s/Talk.0000?at=5");
  for (const other of ["", "https://elsewhere.example/x", here, here + "?a=1", "https://lab.example/other"])
    assert.equal(backAddress(other, here, base), base);
});
