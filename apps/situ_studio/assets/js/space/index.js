// The 3D drawing code: the page loads it with its first 3D panel.

export { openStage } from "./stage.js";
