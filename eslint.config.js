// What eslint holds of the scripts: its recommended rules, and which room of the labelling page may
// use which.

import js from "@eslint/js";
import { importX } from "eslint-plugin-import-x";
import globals from "globals";

const PAGE = "labels/page/static";
// From top to bottom, below start/, which uses all: a room uses those of the rows below it, and
// none of its own row.
const LAYERS = [
  ["frame", "overview", "sheets", "files"],
  ["labelling"],
  ["saving"],
  ["core"],
];

const layerRules = LAYERS.flatMap((rooms, row) => rooms.map((room) => roomRule(room, row)));

/** What one room may not import: the rows above it and the other rooms of its own. */
function roomRule(room, row) {
  const barred = ["start", ...LAYERS.slice(0, row + 1).flat()].filter((other) => other !== room);
  const message = `${room}/ stands below it or beside it.`;
  return {
    files: [`${PAGE}/${room}/**`],
    rules: {
      "no-restricted-imports": [
        "error", { patterns: [{ group: barred.map((other) => `../${other}/*`), message }] },
      ],
    },
  };
}

export default [
  { ignores: ["build/", "dist/", "demo-out/", ".venv*/", "src/"] },
  js.configs.recommended,
  {
    languageOptions: { ecmaVersion: "latest", sourceType: "module" },
    linterOptions: { reportUnusedDisableDirectives: "error" },
    plugins: { "import-x": importX },
    rules: {
      "import-x/no-cycle": "error",
      "import-x/no-unresolved": "error",
      "import-x/named": "error",
      eqeqeq: "error",
      "no-var": "error",
      "prefer-const": "error",
      "no-unused-vars": ["error", { ignoreRestSiblings: true, argsIgnorePattern: "^_" }],
    },
  },
  {
    files: [`${PAGE}/**`, "training/compare/explorer.js", "docs/site/**"],
    languageOptions: { globals: globals.browser },
  },
  { files: ["training/compare/explorer.js"], languageOptions: { sourceType: "script" } },
  { files: ["tests/**", "*.config.js"], languageOptions: { globals: globals.node } },
  ...layerRules,
];
