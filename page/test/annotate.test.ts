// What the head of the annotate page counts.
import assert from "node:assert/strict";
import { test } from "node:test";
import { counted } from "../src/annotate/desk";

test("before the first target no frame is known, and after it every target's frames count", () => {
  assert.equal(counted([], 500)("."), 500);
  assert.equal(counted([], 500)("t"), 0);
  const target = { name: "a", how: "gtt..", percent: [], boxes: [] };
  const count = counted([target, { ...target, how: "gttti" }], 5);
  assert.deepEqual(["g", "t", "i", "x", "."].map(count), [2, 5, 1, 0, 2]);
});
