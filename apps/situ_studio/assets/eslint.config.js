// Lints all JavaScript of the project. `npm run lint` runs it from the project's folder, since ESLint ignores files
// outside of its working directory.
import js from "@eslint/js";
import globals from "globals";

export default [
  { ignores: ["**/priv/static/**"] },
  js.configs.recommended,
  {
    linterOptions: { reportUnusedDisableDirectives: "error" },
    rules: {
      // `x == null` also finds undefined
      eqeqeq: ["error", "always", { null: "ignore" }],
      "no-shadow": "error",
      // a parameter before a used one
      "no-unused-vars": ["error", { argsIgnorePattern: "^_" }],
      "no-var": "error",
      "prefer-const": ["error", { destructuring: "all" }],
    },
  },
  { files: ["apps/*/assets/{js,css}/**"], languageOptions: { globals: globals.browser } },
  { files: ["apps/*/assets/js/**/worker.js"], languageOptions: { globals: globals.worker } },
  { files: ["apps/*/assets/js/**/worklet.js"], languageOptions: { globals: globals.audioWorklet } },
  { files: ["apps/*/assets/css/theme.js"], languageOptions: { sourceType: "script" } },
  // Tests run in Node.js, and parts of the browser tests on the page.
  {
    files: ["apps/*/assets/test/**", "apps/*/assets/*.{js,mjs}", "test/**"],
    languageOptions: { globals: { ...globals.node, ...globals.browser } },
  },
];
