// Sends events to the page's server process, from an element that contains nothing else. LiveView holds back changes
// inside of the element that sends an event until the reply, and panels that are moved meanwhile would appear twice.

import { showToast } from "./toast.js";

/** @type {any} the hook's object */
let channel = null;

export const hooks = {
  Channel: {
    mounted() {
      channel = this;
    },
    destroyed() {
      channel = null;
    },
  },
};

// Changes that are made while the server is unreachable are lost, so a message is shown.
/**
 * @param {string} event
 * @param {object} payload
 * @param {(reply: any) => void} [onReply]
 */
export function pushEvent(event, payload, onReply) {
  channel
    ?.pushEvent(event, payload)
    .then(onReply ?? (() => {}), () => showToast("The server is not responding: nothing was changed"));
}
