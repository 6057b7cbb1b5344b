// Hooks of pages that live in files of their own; each module names its hooks.
export { hooks } from "./pipeline/hooks.js";
