// What the tests use of Node, without its types: they would be there in the page as well.
declare module "node:assert/strict";
declare module "node:test";
