// Explains to users why the page cannot act as a sensor.
const WORDS = {
  NotAllowedError:
    "The browser was not allowed to use camera or microphone: allow it next to the address bar, then start again.",
  NotFoundError: "No camera or microphone found: plug one in, then start again.",
  NotReadableError: "The camera or microphone cannot be used: another program may be using it.",
  OverconstrainedError: "The selected device is not available: select another one.",
};

export const NOTHING = "No camera or microphone selected: select one above, or plug one in and start again.";

export const errorText = (error) => WORDS[error.name] ?? `It did not start: ${error.message}`;
