// Collects the hooks of pages that have their own modules.
import { hooks as back } from "./page/back_link.js";
import { hooks as bookmarks } from "./page/bookmarks.js";
import { hooks as channel } from "./page/channel.js";
import { hooks as edges } from "./page/resize_handles.js";
import { hooks as enter } from "./page/submit_on_enter.js";
import { hooks as experiment } from "./page/experiment.js";
import { hooks as lists } from "./page/lists.js";
import { hooks as more } from "./page/overflow_menu.js";
import { hooks as settings } from "./page/settings_page.js";
import { hooks as upload } from "./page/upload.js";
import { hooks as pipeline } from "./pipeline/hooks.js";

export const hooks = {
  ...back,
  ...bookmarks,
  ...channel,
  ...edges,
  ...enter,
  ...experiment,
  ...lists,
  ...more,
  ...settings,
  ...upload,
  ...pipeline,
};
