// Hooks of pages that live in files of their own; each module names its hooks.
import { hooks as back } from "./page/back.js";
import { hooks as edges } from "./page/edges.js";
import { hooks as enter } from "./page/enter.js";
import { hooks as lists } from "./page/lists.js";
import { hooks as more } from "./page/more.js";
import { hooks as settings } from "./page/settings_page.js";
import { hooks as pipeline } from "./pipeline/hooks.js";

export const hooks = { ...back, ...edges, ...enter, ...lists, ...more, ...settings, ...pipeline };
