// The page of a headset: sends the poses of head, hands and eyes to a pipeline, and shows drawings from it.
import { Clock } from "../device/clock.js";
import { connectSocket } from "../device/connection.js";
import { DevicePage } from "../device/page.js";
import { PacketEncoder } from "./packet.js";

const page = new DevicePage({ drawn: 0 });
const { state } = page;
window.situHeadset = state; // for tests and the console
const WANTED = ["hand-tracking", "plane-detection", "gaze-tracking", "eye-tracking"];
const loadDrawing = () => import(new URL("assets/space.js", document.baseURI).href);

/** @returns {Promise<XRSessionMode | null>} */
async function supportedMode() {
  for (const mode of /** @type {const} */ (["immersive-ar", "immersive-vr"]))
    if (await navigator.xr?.isSessionSupported(mode)) return mode;
  return null;
}

async function enterSession() {
  const mode = await supportedMode();
  if (!navigator.xr || !mode) throw new Error("this browser does not support headsets");
  const session = await navigator.xr.requestSession(mode, {
    requiredFeatures: ["local-floor"],
    optionalFeatures: WANTED,
  });
  page.addPart({ stop: () => void session.end().catch(() => {}) });
  session.addEventListener("end", () => page.stop("The session has ended."));
  const { socket, credit } = await connectSocket("headset/socket");
  page.watchConnection(socket);
  const clock = page.addPart(new Clock(socket, state));
  let room = credit;
  /** @type {import("../space/room.js").Room | null} */
  let drawings = null;
  /** @type {ArrayBuffer[]} */
  const waiting = [];
  /** @param {ArrayBuffer} data */
  const drawLayer = (data) => {
    const layer = drawings?.putLayer(data);
    state.drawn++;
    if (socket.readyState === 1) socket.send(JSON.stringify({ drawn: layer }));
  };
  socket.onmessage = ({ data }) => {
    if (typeof data !== "string") return drawings ? drawLayer(data) : waiting.push(data);
    const message = JSON.parse(data);
    if ("pong" in message) clock.receivePong(message);
    if ("credit" in message) room += message.credit;
  };
  const { openRoom } = await loadDrawing();
  const room3d = await openRoom(session, {
    frame: sendFrame,
    /** @param {string} text */
    problem: (text) => page.showStatus(text),
  });
  drawings = room3d;
  page.addPart({ stop: () => room3d.close() });
  const moments = new PacketEncoder(session, await session.requestReferenceSpace("local-floor"));
  waiting.forEach(drawLayer);

  /**
   * @param {number} time
   * @param {XRFrame} xr
   */
  function sendFrame(time, xr) {
    if (state.offset === null || socket.readyState !== 1) return;
    if (room < 1) return void state.dropped++;
    const bytes = moments?.encodeFrame(time, xr);
    if (!bytes) return;
    room--;
    socket.send(bytes);
    state.sent++;
  }

  page.showRunning();
}

/** @param {Error} error */
const errorText = (error) =>
  error.name === "NotAllowedError" || error.name === "SecurityError"
    ? "The browser was not allowed to use the headset."
    : `It did not start: ${error.message}`;

page.listenStart(enterSession, errorText);
supportedMode().then(
  (found) => {
    if (!found)
      page.disable(
        window.isSecureContext
          ? "This browser does not support headsets: open the page in the headset's own browser."
          : "This browser exposes headsets only to secure pages: open the page over https, or on the machine itself.",
      );
  },
  (error) => page.showFailure(errorText(error)),
);
