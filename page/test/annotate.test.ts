// What the head of the annotate page counts.
import assert from "node:assert/strict";
import { test } from "node:test";
import { counted, tidy } from "../src/annotate/desk";

test("before the first target no frame is known, and after it every target's frames count", () => {
  assert.equal(counted([], 500)("."), 500);
  assert.equal(counted([], 500)("t"), 0);
  const target = { name: "a", how: "gtt..", percent: [], boxes: [] };
  const count = counted([target, { ...target, how: "gttti" }], 5);
  assert.deepEqual(["g", "t", "i", "x", "."].map(count), [2, 5, 1, 0, 2]);
});

test("a name that is written is on one line, printable and not too long", () => {
  assert.equal(tidy("  ball\u00a0\t 1\u200b "), "ball 1");
  assert.equal(tidy("\u2028 \n"), "");
  assert.equal([...tidy("\u{1f6b2}".repeat(90))].length, 80);
});
