// The page of a headset: sends the poses of head, hands and eyes to a pipeline, and shows drawings from it.
import { Clock } from "../sensor/clock.js";
import { connectSocket } from "../sensor/connection.js";
import { PacketEncoder } from "./packet.js";

const $ = (id) => document.getElementById(id);
const state = { sent: 0, dropped: 0, drawn: 0, offset: null, running: false };
window.situHeadset = state; // for tests and the console
const WANTED = ["hand-tracking", "plane-detection", "gaze-tracking", "eye-tracking"];
const loadDrawing = () => import(new URL("assets/space.js", document.baseURI).href);
let stop = () => {};

const showStatus = (text) => ($("status").textContent = text);

async function supportedMode() {
  for (const mode of ["immersive-ar", "immersive-vr"]) if (await navigator.xr?.isSessionSupported(mode)) return mode;
  return null;
}

async function enterSession() {
  const session = await navigator.xr.requestSession(await supportedMode(), {
    requiredFeatures: ["local-floor"],
    optionalFeatures: WANTED,
  });
  const parts = [{ stop: () => session.end().catch(() => {}) }];
  stop = (why) => {
    stop = () => {};
    for (const part of parts) part.stop();
    state.running = false;
    $("start").hidden = false;
    $("stop").hidden = true;
    showStatus(why);
  };
  session.addEventListener("end", () => stop("The session has ended."));
  const { socket, credit } = await connectSocket("headset/socket");
  parts.push({ stop: () => socket.close() });
  socket.onclose = ({ reason }) => stop(reason || "The pipeline has ended, or the connection was lost.");
  const clock = new Clock(socket, state);
  parts.push(clock);
  let room = credit;
  let drawings = null;
  const waiting = [];
  const drawLayer = (data) => {
    const layer = drawings.putLayer(data);
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
  drawings = await openRoom(session, { frame: sendFrame, problem: (text) => showStatus(text) });
  parts.push({ stop: () => drawings.close() });
  const moments = new PacketEncoder(session, await session.requestReferenceSpace("local-floor"));
  waiting.forEach(drawLayer);

  function sendFrame(time, xr) {
    if (state.offset === null || socket.readyState !== 1) return;
    if (room < 1) return void state.dropped++;
    const bytes = moments?.encodeFrame(time, xr);
    if (!bytes) return;
    room--;
    socket.send(bytes);
    state.sent++;
  }

  state.running = true;
  $("start").hidden = true;
  $("stop").hidden = false;
  showStatus("Running.");
}

const errorText = (error) =>
  error.name === "NotAllowedError" || error.name === "SecurityError"
    ? "The browser was not allowed to use the headset."
    : `It did not start: ${error.message}`;

const showFailure = (error) => {
  stop(errorText(error));
  showStatus(errorText(error));
};

supportedMode().then((found) => {
  $("start").disabled = !found;
  if (!found)
    showStatus(
      window.isSecureContext
        ? "This browser does not support headsets: open the page in the headset's own browser."
        : "This browser exposes headsets only to secure pages: open the page over https, or on the machine itself.",
    );
}, showFailure);
$("start").onclick = () => enterSession().catch(showFailure);
$("stop").onclick = () => stop("Stopped.");
