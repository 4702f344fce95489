// A box is green only where a fitted score says that it is on the target.
import assert from "node:assert/strict";
import { test } from "node:test";
import { INK, inkOf } from "../src/view/paint";
import { statusName } from "../src/view/theme";

test("a box that is followed without a fitted score is not green", () => {
  assert.equal(inkOf({ calibrated: true }, "tracking"), INK.tracking);
  assert.equal(inkOf({ calibrated: false }, "tracking"), INK.followed);
  assert.equal(inkOf({ calibrated: false }, "lost"), INK.lost);
});

test("a stretch that is followed without a fitted score is not green in the timeline", () => {
  assert.equal(statusName({ calibrated: true }, "tracking"), "tracking");
  assert.equal(statusName({ calibrated: false }, "tracking"), "soft");
  assert.equal(statusName({ calibrated: false }, "lost"), "lost");
});
