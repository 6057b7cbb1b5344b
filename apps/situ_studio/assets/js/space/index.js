// What draws in space: loaded by the page with its first 3D panel.

export { openStage } from "./stage.js";
