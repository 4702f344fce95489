// Builds the page into the Python package. The same sources and versions give the same bytes.
import { build } from "esbuild";

const out = new URL("../bayesnet_track/view/page/", import.meta.url).pathname;
await build({
  entryPoints: { run_page: "src/main.tsx" },
  outdir: process.argv[2] ?? out,
  bundle: true,
  minify: true,
  format: "iife",
  target: ["es2022"],
  charset: "ascii",
  legalComments: "none",
  jsx: "automatic",
  jsxImportSource: "preact",
  banner: {
    js: "/* bayesnet_track run page; contains preact and @preact/signals (MIT, Jason Miller and the Preact " +
      "authors) and uPlot (MIT, Leon Sorokin). Built from page/. */",
  },
  logLevel: "warning",
});
