// A box is green only where a fitted score says that it is on the target.
import assert from "node:assert/strict";
import { test } from "node:test";
import { INK, inkOf } from "../src/view/paint";

test("a box that is followed without a fitted score is not green", () => {
  assert.equal(inkOf({ calibrated: true }, "tracking"), INK.tracking);
  assert.equal(inkOf({ calibrated: false }, "tracking"), INK.followed);
  assert.equal(inkOf({ calibrated: false }, "lost"), INK.lost);
});
