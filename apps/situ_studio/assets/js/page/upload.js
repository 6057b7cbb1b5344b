// Adds recordings to the studio's folder: files and folders that are dropped on the page or chosen.

import { getElement } from "./dom.js";
import { droppedItems, chosenItems } from "./upload_items.js";
import { showToast } from "./toast.js";

/** @import { UploadItem } from "./upload_items.js" */

const CHUNK_BYTES = 128 * 1024;
const IN_FLIGHT_BYTES = 4 * CHUNK_BYTES;

// Uploads one item. Calls `progress` with the number of bytes that the server has written. Returns the path of the
// recording's page, which is empty for a folder of several recordings.
/**
 * @param {UploadItem} item
 * @param {(received: number) => void} progress
 * @returns {Promise<string>}
 */
function uploadItem(item, progress) {
  const address = new URL("upload/socket", document.baseURI);
  address.protocol = address.protocol.replace("http", "ws");
  const socket = new WebSocket(address);
  const chunks = readChunks(item);
  let sent = 0;
  let sending = false;

  const sendChunks = async (received) => {
    if (sending) return;
    sending = true;
    while (sent - received() < IN_FLIGHT_BYTES) {
      const { value } = await chunks.next();
      if (!value || socket.readyState !== WebSocket.OPEN) break;
      socket.send(value);
      sent += value.byteLength;
    }
    sending = false;
  };

  return new Promise((done, failed) => {
    let received = 0;
    const files = item.files.map(({ path, file }) => ({ path, size: file.size }));
    const reportFailure = (error) => {
      socket.close();
      failed(error);
    };
    socket.onopen = () => socket.send(JSON.stringify({ name: item.name, files }));
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if ("error" in message) return reportFailure(new Error(message.error));
      if ("done" in message) {
        socket.close();
        return done(message.done);
      }
      received = message.received;
      progress(received);
      sendChunks(() => received).catch(reportFailure);
    };
    socket.onclose = ({ reason }) =>
      failed(new Error(reason || "The connection was lost. Nothing was added: try again."));
  });
}

/** @param {UploadItem} item */
async function* readChunks({ files }) {
  for (const { file } of files)
    for (let start = 0; start < file.size; start += CHUNK_BYTES)
      yield await file.slice(start, start + CHUNK_BYTES).arrayBuffer();
}

// Uploads the items one after the other, and opens the recording if there is only one.
/** @param {UploadItem[]} items */
async function uploadAll(items) {
  const state = getElement("upload-state");
  let page = "";
  for (const item of items) {
    const size = item.files.reduce((sum, { file }) => sum + file.size, 0);
    const show = (received) =>
      (state.textContent = `${item.name}: ${size ? Math.floor((100 * received) / size) : 100} %`);
    try {
      page = await uploadItem(item, show);
      state.textContent = `${item.name} was added.`;
    } catch (error) {
      state.textContent = error instanceof Error ? error.message : String(error);
      return;
    }
  }
  if (items.length === 1 && page) location.assign(page);
}

export const hooks = {
  Upload: {
    mounted() {
      this.open = this.el.open;
      this.el.addEventListener("toggle", () => (this.open = this.el.open));
      if (!this.el.dataset.uploads) return;
      this.listenFiles("upload-file");
      this.listenFiles("upload-folder");
      this.dragOver = (e) => {
        if (!e.dataTransfer?.types.includes("Files")) return;
        e.preventDefault();
        document.body.classList.toggle("dropping", e.type === "dragover");
      };
      this.drop = async (e) => {
        if (!e.dataTransfer?.types.includes("Files")) return;
        this.dragOver(e);
        this.add(await droppedItems(e.dataTransfer));
      };
      document.addEventListener("dragover", this.dragOver);
      document.addEventListener("dragleave", this.dragOver);
      document.addEventListener("drop", this.drop);
    },
    // The server does not know whether the panel is open.
    updated() {
      this.el.open = this.open;
    },
    listenFiles(id) {
      const input = getElement(id, HTMLInputElement);
      input.onchange = () => {
        this.add(chosenItems(input.files ?? []));
        input.value = "";
      };
    },
    add(items) {
      if (this.busy) return showToast("Wait until the last upload has ended");
      this.el.open = true;
      this.busy = true;
      uploadAll(items).finally(() => (this.busy = false));
    },
    destroyed() {
      document.removeEventListener("dragover", this.dragOver);
      document.removeEventListener("dragleave", this.dragOver);
      document.removeEventListener("drop", this.drop);
    },
  },
};
