// The shared part of the pages that act as a device (sensor, headset): their state, buttons and status line.

import { getElement } from "../page/dom.js";

/**
 * @typedef {object} DeviceState
 * @property {number} sent
 * @property {number} dropped
 * @property {number | null} offset of this page's clock from the server's in ms
 * @property {number} [trip] the duration in ms of the round trip that measured the offset
 * @property {boolean} running
 */

// `T` are the counters of a page in addition to those of every page.
/** @template {Record<string, number>} T */
export class DevicePage {
  /** @param {T} counters */
  constructor(counters) {
    /** @type {DeviceState & T} */
    this.state = { ...counters, sent: 0, dropped: 0, offset: null, running: false };
    // what must be stopped at the end of the session, or null between sessions
    /** @type {{stop: () => void}[] | null} */
    this.parts = null;
    getElement("stop").onclick = () => this.stop("Stopped.");
  }

  // Calls `start`, which starts a session, when the user presses the button.
  /**
   * @param {() => Promise<void>} start
   * @param {(error: Error) => string} errorText
   */
  listenStart(start, errorText) {
    getElement("start").onclick = () => start().catch((error) => this.showFailure(errorText(error)));
  }

  /** @param {string} text */
  showFailure(text) {
    this.stop(text);
    this.showStatus(text);
  }

  // Disables the page, which cannot work in this browser.
  /** @param {string} text */
  disable(text) {
    getElement("start", HTMLButtonElement).disabled = true;
    this.showStatus(text);
  }

  // Ends the session when the connection closes, and the reverse.
  /** @param {WebSocket} socket */
  watchConnection(socket) {
    this.addPart({ stop: () => socket.close() });
    socket.onclose = ({ reason }) => this.stop(reason || "The pipeline has ended, or the connection was lost.");
  }

  /**
   * @template {{stop: () => void}} P
   * @param {P} part
   * @returns {P}
   */
  addPart(part) {
    this.parts = [...(this.parts ?? []), part];
    return part;
  }

  showRunning() {
    this.showSession(true);
    this.showStatus("Running.");
  }

  // Ends the session, if there is one.
  /** @param {string} why */
  stop(why) {
    if (!this.parts) return;
    const parts = this.parts;
    this.parts = null;
    for (const part of parts) part.stop();
    this.showSession(false);
    this.showStatus(why);
  }

  /** @param {boolean} running */
  showSession(running) {
    this.state.running = running;
    getElement("start").hidden = running;
    getElement("stop").hidden = !running;
  }

  /** @param {string} text */
  showStatus(text) {
    getElement("status").textContent = text;
  }
}
