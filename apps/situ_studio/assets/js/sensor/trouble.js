// Why the page cannot be a sensor, in words of somebody who wants to use one.
const WORDS = {
  NotAllowedError:
    "The browser was not allowed to use camera or microphone: allow it (beside the address), then start again.",
  NotFoundError: "There is no camera or microphone here: plug one in, then start again.",
  NotReadableError: "Camera or microphone cannot be used: another program may have it.",
  OverconstrainedError: "The device that was chosen is gone: choose another one.",
};

export const NOTHING = "Neither camera nor microphone: choose one above, or plug one in and start again.";

export const trouble = (error) => WORDS[error.name] ?? `It did not start: ${error.message}`;
