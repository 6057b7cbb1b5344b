// The 3D drawing code: the page loads it with its first 3D panel, or for a headset.

export { openStage } from "./stage.js";
export { openRoom } from "./room.js";
